"""Random changes of encoder input: the same scene seen by a slightly different camera."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F


def jitter_pictures(
    pictures: Float[Tensor, "n 3 h w"], strength: float, generator: torch.Generator
) -> Float[Tensor, "n 3 h w"]:
    """Shifts, zooms and re-colours each picture; values stay in [0, 1].

    At strength 1: shift up to 6 % of the width, zoom 0.92 to 1.08, contrast by 15 %, brightness by 10 %,
    colour by 5 %. Every number comes from `generator`.
    """
    n = pictures.shape[0]

    def uniform(*shape: int) -> Tensor:
        return (torch.rand(*shape, generator=generator) * 2 - 1).to(pictures.device) * strength

    zoom = 1 + 0.08 * uniform(n)
    shift = 0.12 * uniform(n, 2)  # the sampling grid spans 2, so 0.12 is 6 % of the width
    # a zoom and a shift move rows and columns apart from each other: no matrix product per pixel
    height, width = pictures.shape[2:]
    column = (2 * torch.arange(width, device=pictures.device) + 1) / width - 1
    row = (2 * torch.arange(height, device=pictures.device) + 1) / height - 1
    x = (zoom[:, None] * column + shift[:, :1])[:, None, :].expand(n, height, width)
    y = (zoom[:, None] * row + shift[:, 1:])[:, :, None].expand(n, height, width)
    moved = F.grid_sample(pictures, torch.stack([x, y], dim=-1), padding_mode="border", align_corners=False)
    contrast = 1 + 0.15 * uniform(n, 1, 1, 1) + 0.05 * uniform(n, 3, 1, 1)
    brightness = 0.1 * uniform(n, 1, 1, 1)
    return torch.addcmul(0.5 - 0.5 * contrast + brightness, moved, contrast).clamp_(0, 1)
