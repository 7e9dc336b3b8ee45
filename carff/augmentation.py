"""Random changes of encoder input: the same scene seen by a slightly different camera."""

import torch
from jaxtyping import Float
from torch import Tensor


def jitter_pictures(
    pictures: Float[Tensor, "n 3 h w"], strength: float, generator: torch.Generator
) -> Float[Tensor, "n 3 h w"]:
    """Shifts and re-colours each picture; values stay in [0, 1], pixels at the border are repeated.

    At strength 1: shift up to 6 % of the width, contrast by 15 %, brightness by 10 %, colour by 5 %. Shifts are whole
    pixels: interpolation would blur the few pixels that tell two states apart. Every number comes from `generator`.
    """
    n, _, height, width = pictures.shape

    def uniform(*shape: int) -> Tensor:
        return (torch.rand(*shape, generator=generator) * 2 - 1).to(pictures.device) * strength

    shift = (0.06 * width * uniform(n, 2)).round().long()
    row = (torch.arange(height, device=pictures.device) + shift[:, :1]).clamp(0, height - 1)
    column = (torch.arange(width, device=pictures.device) + shift[:, 1:]).clamp(0, width - 1)
    number = torch.arange(n, device=pictures.device)[:, None, None]
    moved = pictures[number, :, row[:, :, None], column[:, None, :]].permute(0, 3, 1, 2)
    contrast = 1 + 0.15 * uniform(n, 1, 1, 1) + 0.05 * uniform(n, 3, 1, 1)
    brightness = 0.1 * uniform(n, 1, 1, 1)
    return torch.addcmul(0.5 - 0.5 * contrast + brightness, moved, contrast).clamp_(0, 1)
