"""A scene with a closed-form picture: a ball that a condition switches on or off, on a checkered floor, under a sky."""

import math

import torch
from torch import Tensor

from hashnerf.cameras import Cameras, image_rays, look_at
from hashnerf.fit import RayBatch
from hashnerf.rays import Rays

BOX = torch.tensor([[-3.0, -3.0, -0.1], [3.0, 3.0, 2.0]])
CENTRE, RADIUS = torch.tensor([0.3, -0.2, 0.8]), 0.8


def true_colour(rays: Rays, ball: Tensor) -> Tensor:
    """What rays see; `ball` says for each whether the ball is there."""
    o, d = rays.origins, rays.directions
    up = d[:, 2:].clamp(min=0)
    colour = torch.tensor([0.8, 0.9, 1.0]) - up * torch.tensor([0.5, 0.3, 0.1])
    t = torch.where(d[:, 2] < -1e-6, -o[:, 2] / d[:, 2].clamp(max=-1e-6), torch.inf)
    place = o + d * torch.where(t.isfinite(), t, 0.0)[:, None]
    floor = t.isfinite() & (place[:, :2].abs() < 2.9).all(dim=1)
    checks = ((place[:, 0].floor() + place[:, 1].floor()) % 2)[:, None]
    colour = torch.where(floor[:, None], 0.2 + 0.6 * checks * torch.tensor([1.0, 0.8, 0.6]), colour)
    b = ((o - CENTRE) * d).sum(dim=1)
    root = b.square() - (o - CENTRE).square().sum(dim=1) + RADIUS**2
    hit = ball & (root > 0) & (-b > 0)
    normal = (o + d * (-b - root.clamp(min=0).sqrt())[:, None] - CENTRE) / RADIUS
    shade = (0.55 + 0.45 * normal[:, 2:]) * torch.tensor([0.9, 0.3, 0.1])
    return torch.where(hit[:, None], shade, colour)


def ring_of_cameras(count: int, size: int, turn: float = 0.0) -> Cameras:
    """Cameras around the scene at many heights, looking at its middle; `turn` (radians) moves them all."""
    poses = []
    for number in range(count):
        angle = 2 * math.pi * number / count + turn
        height = 1.0 + 2.5 * (number * 0.618 % 1)
        place = torch.tensor([4.5 * math.cos(angle), 4.5 * math.sin(angle), height])
        poses.append(look_at(place, torch.tensor([0.0, 0.0, 0.4])).float())
    full = torch.ones(count, 2)
    return Cameras(torch.stack(poses), full * size * 1.1, full * size / 2, torch.zeros(count, 4), size, size)


class Pictures:
    """All rays of all cameras in both states, with their colours."""

    def __init__(self, cameras: Cameras):
        every = [image_rays(cameras, index) for index in range(len(cameras))]
        rays = Rays(torch.cat([r.origins for r in every]), torch.cat([r.directions for r in every]))
        both = torch.cat([torch.zeros(len(rays), dtype=torch.bool), torch.ones(len(rays), dtype=torch.bool)])
        self.rays = Rays(rays.origins.repeat(2, 1), rays.directions.repeat(2, 1))
        self.state = both.long()
        self.rgb = true_colour(self.rays, both)

    def draw(self, step: int, count: int, generator: torch.Generator) -> RayBatch:
        """A batch of random rays; the condition is -1 without and 1 with the ball."""
        rows = torch.randint(len(self.rays), (count,), generator=generator)
        return self.batch(rows)

    def batch(self, rows: Tensor) -> RayBatch:
        """The batch of these rows."""
        conditions = torch.tensor([[-1.0], [1.0]])
        return RayBatch(self.rays.select(rows), self.rgb[rows], conditions, self.state[rows])
