"""PSNR and SSIM against hand-worked values and scikit-image, and the cases that have no number."""

import json
import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from hashnerf.errors import UserError
from hashnerf.metrics import masked_psnr, mean_psnr, mse, psnr, ssim
from tests.hashnerf.refusals import refuses


def _noisy_pair(height=40, width=50, noise=0.1):
    generator = torch.Generator().manual_seed(5)
    truth = torch.rand(height, width, 3, generator=generator)
    return (truth + noise * torch.randn(truth.shape, generator=generator)).clamp(0, 1), truth


def test_psnr_worked_by_hand():
    # error .1 everywhere: mse = .01, psnr = -10 log10(.01) = 20 dB
    truth = torch.full((4, 4, 3), 0.5, dtype=torch.float64)
    assert mse(truth + 0.1, truth) == pytest.approx(0.01)
    assert psnr(truth + 0.1, truth) == pytest.approx(20)


def test_small_errors_are_not_lost_to_rounding():
    # an error of 1e-7 is 140 dB; float32 next to .9 knows only multiples of 6e-8
    truth = torch.full((4, 4, 3), 0.9, dtype=torch.float64)
    assert psnr(truth + 1e-7, truth) == pytest.approx(140, abs=1e-4)


def test_n51_predictions_are_clipped_as_when_saved(numeric_row):
    assert psnr(torch.full((2, 2, 3), 1.2), torch.ones(2, 2, 3)) == math.inf
    numeric_row("N51", "1.2 for 1: squared error", mse(torch.full((2, 2, 3), 1.2), torch.ones(2, 2, 3)))
    worst = abs(mse(torch.full((2, 2, 3), -0.5), torch.full((2, 2, 3), 0.5)) - 0.25)
    numeric_row("N51", "-0.5 for 0.5: squared error, from that of 0 for 0.5", worst, 1e-12)


def test_n51_rounding_to_eight_bits_caps_psnr_near_59_db(numeric_row):
    # rounding errors are uniform over one level: mse = (1/255)^2 / 12, psnr = 20 log10(255) + 10 log10(12) = 58.92 dB
    truth = torch.rand(200, 200, 3, generator=torch.Generator().manual_seed(0))
    worst = abs(psnr((truth * 255).round() / 255, truth) - 58.92)
    numeric_row("N51", "a picture and its 8 bits: dB from 58.92", worst, 0.02)


def test_n52_metrics_agree_with_scikit_image(numeric_row):
    prediction, truth = _noisy_pair()
    a, b = prediction.double().numpy(), truth.double().numpy()
    assert psnr(prediction, truth) == pytest.approx(peak_signal_noise_ratio(b, a, data_range=1.0), abs=1e-9)
    settings_of_wang = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    reference = structural_similarity(b, a, data_range=1.0, channel_axis=2, **settings_of_wang)
    numeric_row("N52", "a noisy pair, from scikit-image in float64", abs(ssim(prediction, truth) - reference), 1e-6)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        numeric_row("N52", "the same under autocast", abs(ssim(prediction, truth) - reference), 1e-6)


def test_n52_ssim_of_simple_pictures(numeric_row):
    black, white = torch.zeros(16, 16, 3), torch.ones(16, 16, 3)
    prediction, truth = _noisy_pair(16, 16)
    numeric_row("N52", "equal pictures, from 1", abs(ssim(truth, truth) - 1), 1e-9)
    numeric_row("N52", "equal black pictures, from 1", abs(ssim(black, black) - 1), 1e-9)
    # means 0 and 1, no variance: C1 / (1 + C1) with C1 = .01^2 = 1e-4, so 9.999e-5
    numeric_row("N52", "black and white, from 9.999e-5", abs(ssim(black, white) - 1e-4 / (1 + 1e-4)), 1e-8)
    assert ssim(prediction, truth) == pytest.approx(ssim(truth, prediction))


def test_n52_ssim_does_not_lose_small_contrast_to_rounding(numeric_row):
    # contrast 1e-4 around .9: in float32 E[x^2] - m^2 would be mostly rounding (6e-8 of .81 against 1e-8)
    truth = 0.9 + 1e-4 * torch.rand(32, 32, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    worst = abs(ssim(truth.float(), truth) - 1)
    numeric_row("N52", "contrast 1e-4 around 0.9, one of two rounded to float32, from 1", worst, 1e-5)


@pytest.mark.parametrize("shape", [(10, 40, 3), (40, 5, 3)])
def test_n52_an_image_smaller_than_the_window_is_refused(shape, numeric_row):
    small, far = torch.zeros(shape), torch.full((16, 16, 3), 1000.0)
    accepted = not refuses(f"at least 11x11 pixels, not {shape[1]}x{shape[0]}", ssim, small, small)
    accepted += not refuses("the prediction reaches 1000", ssim, far, far)
    accepted += not refuses("the truth spans 1000", ssim, far / 1000, far)
    numeric_row("N52", f"{shape[1]} x {shape[0]} pixels, or values of 1000: accepted", accepted)


def test_n53_masked_psnr_counts_its_pixels(numeric_row):
    truth = torch.zeros(2, 2, 3)
    prediction = truth.clone()
    prediction[0, 0] = 0.1  # inside the mask with one perfect pixel: mse = .01/2, psnr = 23.01 dB
    prediction[1, 1] = 0.9  # outside
    value, count = masked_psnr(prediction, truth, torch.tensor([[True, True], [False, False]]))
    assert count == 2 and value == pytest.approx(10 * math.log10(200), abs=1e-5)
    empty = masked_psnr(prediction, truth, torch.zeros(2, 2, dtype=torch.bool))
    numeric_row("N53", "an empty mask: a number, or a count other than 0", float(empty != (None, 0)))


def test_n50_the_mean_over_images_survives_an_identical_pair(numeric_row):
    # mse 0 and 1e-3: the first has no finite psnr, the second 30 dB; the mean mse 5e-4 gives 33.01 dB.
    truth = torch.full((2, 4, 4, 3), 0.5, dtype=torch.float64)
    prediction = truth.clone()
    prediction[1] += 1e-3**0.5
    result = mean_psnr(prediction, truth)
    assert result.per_image[0] == math.inf and result.identical == 1
    assert result.mean == pytest.approx(30) and result.of_mean_mse == pytest.approx(33.0103, abs=1e-4)
    numeric_row("N50", "squared errors 0 and 1e-3: mean PSNR from 30 dB", abs(result.mean - 30), 1e-9)
    numeric_row("N50", "the same: PSNR of the mean error from 33.0103 dB", abs(result.of_mean_mse - 33.0103), 1e-4)
    report = json.loads(json.dumps(result.as_json(), allow_nan=False))
    wrong = (report["per_image"][0] is not None) + (report["identical"] != 1)
    numeric_row("N50", "the same as strict JSON: a number for equal pictures, or not counted", wrong)


def test_n50_only_identical_pairs_give_null_and_no_pairs_are_refused(numeric_row):
    result = mean_psnr(torch.zeros(3, 4, 4, 3), torch.zeros(3, 4, 4, 3))
    wrong = (result.mean is not None) + (result.of_mean_mse is not None) + (result.identical != 3)
    numeric_row("N50", "three equal pairs: a mean, or not counted", wrong)
    with pytest.raises(UserError, match="no images"):
        mean_psnr(torch.zeros(0, 4, 4, 3), torch.zeros(0, 4, 4, 3))


@settings(deadline=None, max_examples=30)
@given(st.lists(st.floats(1e-3, 0.4), min_size=1, max_size=5))
def test_the_mean_of_psnrs_is_never_below_the_psnr_of_the_mean(errors):
    # -log is convex: Jensen
    truth = torch.full((len(errors), 2, 2, 3), 0.5, dtype=torch.float64)
    result = mean_psnr(truth + torch.tensor(errors, dtype=torch.float64)[:, None, None, None], truth)
    assert result.mean >= result.of_mean_mse - 1e-9


GOOD = torch.zeros(2, 2, 3)


@pytest.mark.parametrize(
    "prediction, truth, sentence",
    [
        (GOOD.byte(), GOOD, "the prediction has the type torch.uint8"),
        (GOOD, GOOD.byte(), "the truth has the type torch.uint8"),
        (GOOD, GOOD + 255, "the truth spans 255 to 255"),
        (GOOD, GOOD - 0.1, "the truth spans -0.1 to -0.1"),
        (GOOD + 200, GOOD, "the prediction reaches 200"),
        (GOOD * torch.nan, GOOD, "the prediction is empty or holds values that are not finite"),
        (GOOD, GOOD + torch.inf, "the truth is empty or holds values that are not finite"),
        (GOOD[:0], GOOD[:0], "the prediction is empty"),
        (GOOD, GOOD[:1], "different shapes"),
    ],
)
def test_n50_images_on_other_scales_are_refused(prediction, truth, sentence, numeric_row):
    accepted = sum(not refuses(sentence, metric, prediction, truth) for metric in (mse, psnr))
    numeric_row("N50", f"{sentence}: accepted", accepted)
