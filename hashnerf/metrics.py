"""Image quality between a prediction and the truth, both float RGB in [0, 1], height x width x 3.

Predictions are clipped to [0, 1] first, as they would be when saved, and everything is computed in float64. Identical
images have no finite PSNR: it is math.inf here and null in JSON (`json_number`). A truth that was rounded to 8 bits
limits the PSNR of even a perfect prediction to about 58.9 dB.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Shaped
from kornia.metrics import ssim as kornia_ssim
from torch import Tensor

from hashnerf.errors import UserError

SSIM_WINDOW = 11  # pixels, with sigma 1.5: the window of the original definition
FARTHEST_PREDICTION = 10.0  # a prediction may overshoot and is clipped; one on the 0..255 scale is a mistake
RANGE_SLACK = 1e-3  # how far a truth may leave [0, 1] by rounding


def mse(prediction: Shaped[Tensor, "..."], truth: Shaped[Tensor, "..."]) -> float:
    """The mean squared error over all numbers; raises UserError on 8-bit, non-finite, empty or 0..255 images."""
    return float(_squared_error(prediction, truth).mean())


def psnr(prediction: Shaped[Tensor, "..."], truth: Shaped[Tensor, "..."]) -> float:
    """The peak signal-to-noise ratio in dB for the peak 1.0; math.inf for identical images."""
    return decibels(mse(prediction, truth))


def masked_psnr(
    prediction: Shaped[Tensor, "h w 3"], truth: Shaped[Tensor, "h w 3"], mask: Bool[Tensor, "h w"]
) -> tuple[float | None, int]:
    """The PSNR over the masked pixels and their number; (None, 0) when the mask is empty."""
    count = int(mask.sum())
    if count == 0:
        return None, 0
    return decibels(float(_squared_error(prediction, truth)[mask].mean())), count


def ssim(prediction: Shaped[Tensor, "h w 3"], truth: Shaped[Tensor, "h w 3"]) -> float:
    """The structural similarity (Gaussian 11x11 window, no padding), mean over pixels and channels.

    Raises UserError when the image is smaller than the window.
    """
    clipped, checked = _checked(prediction, truth)
    if min(checked.shape[:2]) < SSIM_WINDOW:
        raise UserError(
            f"SSIM needs images of at least {SSIM_WINDOW}x{SSIM_WINDOW} pixels, not "
            f"{checked.shape[1]}x{checked.shape[0]}"
        )
    # Padding would mirror the border into the windows and change the value in the fourth digit.
    channels = (image.permute(2, 0, 1)[None] for image in (clipped, checked))
    # The denominator is at least 9e-8 by itself; the library's own epsilon would cost two equal black images 1e-5.
    return float(kornia_ssim(*channels, SSIM_WINDOW, max_val=1.0, eps=0.0, padding="valid").mean())


@dataclass(frozen=True)
class MeanPsnr:
    """Both ways to average PSNR over images; dB."""

    per_image: tuple[float, ...]
    identical: int
    mean: float | None
    of_mean_mse: float | None

    def as_json(self) -> dict:
        """The same with null in place of infinite values."""
        return {
            "per_image": [json_number(value) for value in self.per_image],
            "identical": self.identical,
            "mean": self.mean,
            "of_mean_mse": self.of_mean_mse,
        }


def mean_psnr(predictions: Shaped[Tensor, "n h w 3"], truths: Shaped[Tensor, "n h w 3"]) -> MeanPsnr:
    """PSNR of every image, their mean, and the PSNR of the mean squared error.

    Identical pairs are counted and left out of `mean`, which they would make infinite; they do count in `of_mean_mse`.
    A value that does not exist is None. Raises UserError for no images.
    """
    if len(predictions) == 0:
        raise UserError("mean_psnr: there are no images to average over")
    errors = [mse(prediction, truth) for prediction, truth in zip(predictions, truths, strict=True)]
    values = tuple(decibels(error) for error in errors)
    finite = [value for value in values if math.isfinite(value)]
    mean = sum(finite) / len(finite) if finite else None
    return MeanPsnr(values, len(values) - len(finite), mean, json_number(decibels(sum(errors) / len(errors))))


def decibels(mean_squared_error: float) -> float:
    """PSNR of a mean squared error for the peak 1.0; math.inf for zero."""
    return math.inf if mean_squared_error == 0 else -10 * math.log10(mean_squared_error)


def json_number(value: float) -> float | None:
    """The value, or None where JSON has no number for it."""
    return value if math.isfinite(value) else None


def _squared_error(prediction: Shaped[Tensor, "..."], truth: Shaped[Tensor, "..."]) -> Shaped[Tensor, "..."]:
    clipped, checked = _checked(prediction, truth)
    return (clipped - checked) ** 2


def _checked(
    prediction: Shaped[Tensor, "..."], truth: Shaped[Tensor, "..."]
) -> tuple[Shaped[Tensor, "..."], Shaped[Tensor, "..."]]:
    """Prediction clipped to [0, 1] and truth, in float64, after checking that they can be compared at all."""
    if prediction.shape != truth.shape:
        raise UserError(f"images of different shapes cannot be compared: {prediction.shape} and {truth.shape}")
    for name, image in (("prediction", prediction), ("truth", truth)):
        if not image.is_floating_point():
            raise UserError(f"the {name} has the type {image.dtype}; convert it to float in [0, 1] (divide by 255)")
        if image.numel() == 0 or not bool(torch.isfinite(image).all()):
            raise UserError(f"the {name} is empty or holds values that are not finite")
    if float(prediction.abs().max()) > FARTHEST_PREDICTION:
        raise UserError(f"the prediction reaches {float(prediction.abs().max()):g}; images must be in [0, 1]")
    low, high = float(truth.min()), float(truth.max())
    if low < -RANGE_SLACK or high > 1 + RANGE_SLACK:
        raise UserError(f"the truth spans {low:g} to {high:g}; images must be in [0, 1] (divide 8-bit values by 255)")
    return prediction.detach().double().clamp(0, 1), truth.detach().double().clamp(0, 1)
