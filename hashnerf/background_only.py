"""Whether pictures show anything but a background: what a sky that depends on direction alone leaves unexplained."""

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from hashnerf.background import Background
from hashnerf.cameras import Cameras, camera_rays
from hashnerf.metrics import decibels
from hashnerf.rays import Rays

STEPS, PIXELS, RATE = 800, 2048, 0.05
JUDGED = 16384
"""Pixels on which the fitted sky is judged."""
SOON = 100
HOPELESS_DB = 25.0
"""What shows less after the first steps shows things that stand somewhere."""


def background_psnr(
    images: UInt8[Tensor, "n h w 3"],
    cameras: Cameras,
    box: Float[Tensor, "2 3"],
    direction_degree: int,
    sky_width: int,
) -> float:
    """Returns the PSNR (dB) of pictures that are explained by the background alone, after a few seconds of fitting it.

    Where it soon shows that more is there, what it reached until then.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        background = Background(box.float(), direction_degree, 0, False, sky_width)
    generator = torch.Generator().manual_seed(0)
    optimizer = torch.optim.Adam(background.parameters(), lr=RATE)
    for step in range(STEPS):
        for group in optimizer.param_groups:
            group["lr"] = RATE * 0.02 ** (step / STEPS)
        rays, colour = _pixels(images, cameras, PIXELS, generator)
        optimizer.zero_grad()
        (background(rays, []) - colour).square().mean().backward()
        optimizer.step()
        if step == SOON and _psnr(background, images, cameras, generator) < HOPELESS_DB:
            break
    return _psnr(background, images, cameras, generator)


@torch.no_grad()
def _psnr(background: Background, images: Tensor, cameras: Cameras, generator: torch.Generator) -> float:
    rays, colour = _pixels(images, cameras, JUDGED, generator)
    return decibels(float((background(rays, []) - colour).square().mean()))


def _pixels(images: Tensor, cameras: Cameras, count: int, generator: torch.Generator) -> tuple[Rays, Tensor]:
    height, width = images.shape[1:3]
    number = torch.randint(len(images), (count,), generator=generator)
    row = torch.randint(height, (count,), generator=generator)
    column = torch.randint(width, (count,), generator=generator)
    rays = camera_rays(cameras, number, torch.stack([column, row], dim=1) + 0.5)
    return rays, images[number, row, column].float() / 255
