"""A data set without files: the analytic scene as pictures from a ring of cameras."""

from pathlib import Path

import torch

from hashnerf.cameras import image_rays
from hashnerf.posed_images import Frame, PosedImages
from tests.hashnerf.analytic_scene import BOX, ring_of_cameras, true_colour


def posed_scene(count: int = 8, size: int = 24, test_every: int = 4) -> PosedImages:
    """Pictures of the ball on its floor; every `test_every`-th camera is held out."""
    cameras = ring_of_cameras(count, size)
    with_ball = torch.ones(size * size, dtype=torch.bool)
    pictures = [true_colour(image_rays(cameras, index), with_ball).view(size, size, 3) for index in range(count)]
    frames = tuple(
        Frame(f"{index}.png", "train" if index % test_every else "test", 0, 0, index) for index in range(count)
    )
    images = (torch.stack(pictures).clamp(0, 1) * 255).round().to(torch.uint8)
    return PosedImages(images, cameras, frames, BOX, {}, Path("nowhere"))
