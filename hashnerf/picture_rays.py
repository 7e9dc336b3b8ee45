"""Rays through the pixels of posed images, drawn evenly, with the colours that were seen along them."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from hashnerf.cameras import Cameras, camera_rays
from hashnerf.posed_images import PosedImages
from hashnerf.rays import Rays

Correct = Callable[[Float[Tensor, "n 4 4"], Int[Tensor, " n"]], Float[Tensor, "n 4 4"]]
"""From told poses and the pictures' numbers to better poses."""


@dataclass(frozen=True)
class PictureRays:
    """All pixels of some pictures, ready to be drawn from."""

    images: UInt8[Tensor, "n h w 3"]
    poses: Float[Tensor, "n 4 4"]
    local: Float[Tensor, "n_or_one pixels 3"]
    """Directions in the camera's own frame; one row where all lenses are alike."""

    @classmethod
    def of(cls, data: PosedImages) -> "PictureRays":
        """Prepares the pictures of a data set."""
        cameras = data.cameras
        lens = torch.cat([cameras.focal, cameras.centre, cameras.distortion], dim=1)
        alike = bool((lens == lens[0]).all())
        rows = cameras.select([0]) if alike else cameras
        local = torch.stack([local_directions(rows, index) for index in range(len(rows))])
        return cls(data.images, cameras.pose, local)

    def draw(self, count: int, generator: torch.Generator) -> tuple[Int[Tensor, " n"], Int[Tensor, " n"]]:
        """Draws picture numbers and pixels, evenly."""
        pixels = self.local.shape[1]
        place = torch.randint(len(self.images) * pixels, (count,), generator=generator)
        return place // pixels, place % pixels

    def rays(
        self, number: Int[Tensor, " n"], pixel: Int[Tensor, " n"], correct: Correct | None = None
    ) -> tuple[Rays, Float[Tensor, "n 3"]]:
        """Returns the world rays through some pixels, from corrected poses, and their colours."""
        poses = self.poses[number]
        if correct is not None:
            poses = correct(poses, number)
        local = self.local[number if len(self.local) > 1 else torch.zeros_like(number), pixel]
        directions = (poses[:, :3, :3] @ local[:, :, None])[:, :, 0]
        colour = self.images.flatten(1, 2)[number, pixel].float() / 255
        return Rays(poses[:, :3, 3], torch.nn.functional.normalize(directions, dim=1)), colour


def local_directions(cameras: Cameras, index: int) -> Float[Tensor, "pixels 3"]:
    """Returns the unit directions of all pixels of a camera in its own frame."""
    columns, rows = torch.meshgrid(torch.arange(cameras.width), torch.arange(cameras.height), indexing="xy")
    pixel = torch.stack([columns, rows], dim=-1).reshape(-1, 2) + 0.5
    still = Cameras(
        torch.eye(4)[None],
        cameras.focal[index : index + 1],
        cameras.centre[index : index + 1],
        cameras.distortion[index : index + 1],
        cameras.width,
        cameras.height,
    )
    return camera_rays(still, torch.zeros(len(pixel), dtype=torch.int64), pixel).directions
