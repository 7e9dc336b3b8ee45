"""Whether pictures show anything but a background: what a sky that depends on direction alone leaves unexplained."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn.functional import avg_pool2d

from hashnerf.background import Background
from hashnerf.cameras import Cameras, camera_rays, image_rays
from hashnerf.metrics import decibels
from hashnerf.rays import Rays
from hashnerf.visible_volume import evenly

STEPS, PIXELS, RATE = 800, 2048, 0.05
SOON, HOPELESS_DB = 100, 25.0
"""What shows less after the first steps shows things that stand somewhere."""
JUDGED = 16384
"""Pixels on which that is judged."""
RAYS_AT_ONCE = 1 << 16
BLOCK = 8
"""Side of a block, pixels: a small thing before a wide sky spoils its own block, but hardly the mean."""
MOST_PICTURES = 16
"""Pictures that are compared whole, evenly chosen."""


@dataclass(frozen=True)
class Explained:
    """How well a background alone shows pictures, PSNR in dB."""

    mean_db: float
    worst_block_db: float
    """Of the worst block of 8 x 8 pixels; where the mean is hopeless, that."""


def background_alone(
    images: UInt8[Tensor, "n h w 3"],
    cameras: Cameras,
    box: Float[Tensor, "2 3"],
    direction_degree: int,
    sky_width: int,
) -> Explained:
    """Fits a background to pictures for a few seconds, or for less where it soon shows that more is there."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        background = Background(box.float().cpu(), direction_degree, 0, False, sky_width)
    generator = torch.Generator().manual_seed(0)
    optimizer = torch.optim.Adam(background.parameters(), lr=RATE)
    for step in range(STEPS):
        for group in optimizer.param_groups:
            group["lr"] = RATE * 0.02 ** (step / STEPS)
        optimizer.zero_grad()
        _error(background, images, cameras, PIXELS, generator).backward()
        optimizer.step()
        if step == SOON:
            with torch.no_grad():
                soon = decibels(float(_error(background, images, cameras, JUDGED, generator)))
            if soon < HOPELESS_DB:
                return Explained(soon, soon)
    return _whole_pictures(background, images, cameras)


@torch.no_grad()
def _whole_pictures(background: Background, images: Tensor, cameras: Cameras) -> Explained:
    total, worst, chosen = 0.0, 0.0, evenly(len(images), MOST_PICTURES)
    for index in chosen.tolist():
        true = images[index].float() / 255
        rays = image_rays(cameras, index)
        parts = [rays.select(slice(at, at + RAYS_AT_ONCE)) for at in range(0, len(rays), RAYS_AT_ONCE)]
        seen = torch.cat([background(part, []) for part in parts])
        squared = (seen.view(true.shape) - true).square().mean(dim=2)
        total += float(squared.mean())
        blocks = avg_pool2d(squared[None], BLOCK, ceil_mode=True, count_include_pad=False)
        worst = max(worst, float(blocks.max()))
    return Explained(decibels(total / len(chosen)), decibels(worst))


def _error(
    background: Background, images: Tensor, cameras: Cameras, count: int, generator: torch.Generator
) -> Float[Tensor, ""]:
    rays, colour = _pixels(images, cameras, count, generator)
    return (background(rays, []) - colour).square().mean()


def _pixels(images: Tensor, cameras: Cameras, count: int, generator: torch.Generator) -> tuple[Rays, Tensor]:
    height, width = images.shape[1:3]
    number = torch.randint(len(images), (count,), generator=generator)
    row = torch.randint(height, (count,), generator=generator)
    column = torch.randint(width, (count,), generator=generator)
    rays = camera_rays(cameras, number, torch.stack([column, row], dim=1) + 0.5)
    return rays, images[number, row, column].float() / 255
