"""Image encoders of the PC-VAE: pictures in, Gaussian belief parameters out (CARFF 3.1, B.1).

`prepare` runs once over a set of pictures (uint8 [n, h, w, 3]) and gives what the trainable part reads at every step:
for `conv` the pictures themselves, for `vit` the features of a frozen Vision Transformer, computed once and kept.
`forward` gives `raw` [n, 2 * latent_size]: mean and unbounded log-variance side by side.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn

from carff.augmentation import jitter_pictures
from hashnerf.errors import UserError
from hashnerf.low_precision import multiplies_bfloat16

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)
SIDE_MULTIPLE = 32  # pixels: the convolutional encoder halves a picture five times


@dataclass(frozen=True)
class EncoderConfig:
    """What turns a picture into a belief."""

    kind: Literal["conv", "vit"] = "conv"
    """`conv` is trained from scratch, without download; `vit` is a frozen Vision Transformer with a trained head."""
    width: int = 48
    """Channels of the first stage of `conv`; the later stages have 2 and 4 times as many."""
    augment: float = 1.0
    """Strength of shift and colour jitter on `conv` input during training; 0 switches it off."""
    dropout: float = 0.0
    """Dropout before the last layer."""
    vit_model: str = "google/vit-large-patch16-224"
    """Hub id or local folder of the Vision Transformer that `vit` uses."""

    def __post_init__(self):
        if self.width < 8 or self.width % 8:
            raise UserError(f"encoder.width is {self.width}; give a positive multiple of 8")
        if not 0.0 <= self.dropout < 1.0:
            raise UserError(f"encoder.dropout is {self.dropout}; give a value in [0, 1)")


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions with batch normalisation and a skip; `stride` halves the picture."""

    def __init__(self, channels_in: int, channels_out: int, stride: int):
        super().__init__()
        self.first = nn.Conv2d(channels_in, channels_out, 3, stride, 1)
        self.first_norm = nn.BatchNorm2d(channels_out)
        self.second = nn.Conv2d(channels_out, channels_out, 3, 1, 1)
        self.second_norm = nn.BatchNorm2d(channels_out)
        same = channels_in == channels_out and stride == 1
        self.skip = nn.Identity() if same else nn.Conv2d(channels_in, channels_out, 1, stride)

    def forward(self, x: Float[Tensor, "n cin h w"]) -> Float[Tensor, "n cout h2 w2"]:
        """Returns the block's feature maps."""
        y = torch.relu(self.first_norm(self.first(x)))
        return torch.relu(self.second_norm(self.second(y)) + self.skip(x))


class ConvEncoder(nn.Module):
    """A small residual network.

    Batch normalisation is frozen outside training, so that one picture gives the same belief alone and in a batch; its
    backward pass on a processor is cheaper than that of a group normalisation.
    """

    def __init__(self, config: EncoderConfig, latent_size: int, height: int, width: int):
        super().__init__()
        if height % SIDE_MULTIPLE or width % SIDE_MULTIPLE:
            raise UserError(
                f"the conv encoder needs pictures whose sides are multiples of {SIDE_MULTIPLE}, not {width} x {height}"
                ": crop them, or give an image_size (a width) that makes both so"
            )
        self.augment = config.augment
        w = config.width
        self.trunk = nn.Sequential(
            nn.Conv2d(3, 16, 5, 2, 2),
            nn.ReLU(),
            nn.Conv2d(16, w, 3, 2, 1),
            nn.BatchNorm2d(w),
            nn.ReLU(),
            ResidualBlock(w, w, 1),
            ResidualBlock(w, 2 * w, 2),
            ResidualBlock(2 * w, 4 * w, 2),
            ResidualBlock(4 * w, 4 * w, 2),
        )
        self.head = nn.Sequential(
            nn.Flatten(),
            nn.Dropout(config.dropout),
            nn.Linear(4 * w * (height // 32) * (width // 32), 256),
            nn.ReLU(),
            nn.Linear(256, 2 * latent_size),
        )
        self.to(memory_format=torch.channels_last)

    def prepare(self, pictures: UInt8[Tensor, "n h w 3"]) -> UInt8[Tensor, "n h w 3"]:
        """Returns the pictures as they are: the convolutions read pixels."""
        return pictures

    def forward(
        self, prepared: UInt8[Tensor, "n h w 3"], generator: torch.Generator | None = None
    ) -> Float[Tensor, "n raw"]:
        """Returns mean and raw log-variance; with a `generator` the pictures are jittered (training)."""
        x = prepared.permute(0, 3, 1, 2).float() / 255.0
        if generator is not None and self.augment > 0:
            x = jitter_pictures(x, self.augment, generator)
        x = (x - 0.5).contiguous(memory_format=torch.channels_last)
        # bfloat16 where it is faster; the belief itself is single precision
        with _fastest_products(x.device.type):
            features = self.trunk(x)
        return self.head(features.float())


class VitEncoder(nn.Module):
    """A frozen Vision Transformer whose features are computed once, and a small trained head.

    Features are the class token and the mean of the patch tokens after the last layer, of pictures normalised with the
    ImageNet statistics. (Deviation: the published code trains a 3-channel convolution in front of the transformer and
    back-propagates through 304 M frozen weights at every step to do so.)
    """

    def __init__(self, config: EncoderConfig, latent_size: int):
        super().__init__()
        # Not registered as a sub-module: the frozen weights are no part of a checkpoint.
        self.backbone = [load_vit(config.vit_model)]
        hidden = self.backbone[0].config.hidden_size
        self.input_size = self.backbone[0].config.image_size
        self.head = nn.Sequential(
            nn.LayerNorm(2 * hidden),
            nn.Dropout(config.dropout),
            nn.Linear(2 * hidden, 256),
            nn.GELU(),
            nn.Linear(256, 2 * latent_size),
        )

    @torch.no_grad()
    def prepare(self, pictures: UInt8[Tensor, "n h w 3"], batch: int = 8) -> Float[Tensor, "n features"]:
        """Returns the frozen features of the pictures, `batch` at a time."""
        device = self.head[2].weight.device
        backbone = self.backbone[0].to(device).eval()
        mean = torch.tensor(IMAGENET_MEAN, device=device)[:, None, None]
        std = torch.tensor(IMAGENET_STD, device=device)[:, None, None]
        rows = []
        for part in pictures.split(batch):
            x = part.to(device).permute(0, 3, 1, 2).float() / 255.0
            x = nn.functional.interpolate(x, (self.input_size, self.input_size), mode="bilinear", antialias=True)
            with _fastest_products(device.type):
                tokens = backbone(pixel_values=(x - mean) / std).last_hidden_state
            tokens = tokens.float()
            rows.append(torch.cat([tokens[:, 0], tokens[:, 1:].mean(dim=1)], dim=-1))
        return torch.cat(rows)

    def forward(
        self, prepared: Float[Tensor, "n features"], generator: torch.Generator | None = None
    ) -> Float[Tensor, "n raw"]:
        """Returns mean and raw log-variance of prepared features."""
        del generator  # cached features cannot be jittered
        return self.head(prepared)


def _fastest_products(device_type: str) -> torch.autocast:
    # copies of weights would live as long as the outermost autocast, which may last for the whole training
    return torch.autocast(
        device_type, dtype=torch.bfloat16, enabled=multiplies_bfloat16(device_type), cache_enabled=False
    )


def load_vit(model: str) -> nn.Module:
    """Loads a Vision Transformer by hub id or local folder; raises UserError with the reason when it cannot."""
    try:
        from transformers import ViTModel
    except ImportError as error:
        raise UserError("the vit encoder needs the extra `vit`: pip install -e .[vit]") from error
    try:
        vit = ViTModel.from_pretrained(model, add_pooling_layer=False)
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise UserError(
            f"encoder.vit_model {model!r} cannot be loaded ({reason}); give a local folder or a hub id"
        ) from error
    return vit.requires_grad_(False)


def build_encoder(config: EncoderConfig, latent_size: int, height: int, width: int) -> ConvEncoder | VitEncoder:
    """Returns the encoder that the config names."""
    if config.kind == "vit":
        return VitEncoder(config, latent_size)
    return ConvEncoder(config, latent_size, height, width)
