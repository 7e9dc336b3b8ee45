"""Which part of a box cameras see."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from hashnerf.cameras import Cameras, project

LATTICE = 24
"""Points along each side of a box that is to be trimmed."""
VIEWS = 2
"""Pictures that must show a place before anything can be known of its depth."""
MOST_CAMERAS = 256
"""Cameras that are asked, evenly chosen."""


def box_lattice(box: Float[Tensor, "2 3"], side: int) -> Float[Tensor, "points 3"]:
    """Returns the middles of the cells (metres) when each side of a box is cut into `side` parts."""
    share = (torch.arange(side, device=box.device) + 0.5) / side
    return box[0] + torch.cartesian_prod(share, share, share) * (box[1] - box[0])


def visible_points(
    cameras: Cameras, points: Float[Tensor, "points 3"]
) -> tuple[Bool[Tensor, "n points"], Float[Tensor, "n points"]]:
    """Returns whether each camera has each point (metres) in its picture, and its depth along the optical axis.

    Nothing is taken to stand in between.
    """
    number = torch.arange(len(cameras), device=points.device).repeat_interleave(len(points))
    pixel, depth = project(cameras, number, points.repeat(len(cameras), 1))
    size = torch.tensor([cameras.width, cameras.height]).to(pixel)
    inside = ((pixel >= 0) & (pixel < size)).all(dim=1)  # NaN, behind the camera, is not
    return inside.view(len(cameras), -1), depth.view(len(cameras), -1)


def evenly(count: int, most: int) -> Int[Tensor, " chosen"]:
    """Returns `most` of the numbers below `count`, evenly spaced, or all if there are no more."""
    return torch.linspace(0, count - 1, min(count, most)).round().long()


def visible_box(cameras: Cameras, box: Float[Tensor, "2 3"]) -> Float[Tensor, "2 3"]:
    """Returns the part of a box (metres) that at least two of the cameras see (one, if there is but one).

    The whole box where no point of a lattice is seen: a box thinner than the gaps between lines of sight.
    """
    points = box_lattice(box, LATTICE)
    views = torch.zeros(len(points), dtype=torch.int64, device=points.device)
    for index in evenly(len(cameras), MOST_CAMERAS).split(1):  # all at once would be gigabytes
        views += visible_points(cameras.select(index), points)[0][0]
    seen = points[views >= min(VIEWS, len(cameras))]
    if not len(seen):
        return box
    half = (box[1] - box[0]) / (2 * LATTICE)
    return torch.stack([seen.amin(dim=0) - half, seen.amax(dim=0) + half])
