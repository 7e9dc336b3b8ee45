"""Sample positions along rays: a fixed number of candidates between box entry and exit, of which the occupied stay.

Candidates are stratified: interval edges are evenly spaced in log(t + c), so they grow in proportion to the distance t
from the camera beyond about c metres. One sample lies in each interval, at its middle or at random; dt is the
interval's length, so the lengths of one ray always sum to far - near.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from hashnerf.errors import UserError
from hashnerf.occupancy import OccupancyGrid
from hashnerf.ray_box import intersect_box
from hashnerf.rays import Rays


@dataclass(frozen=True)
class MarchSettings:
    """How rays are sampled."""

    candidates: int = 192
    """Positions tried along a ray between entering and leaving the scene box."""
    even_distance: float = 20.0
    """Up to about this distance (m) positions are evenly spaced, beyond it the spacing grows with distance."""
    near: float = 0.05
    """Nothing closer to the camera than this (m) is sampled."""
    stop_transmittance: float = 1e-3
    """A ray ends where cells known opaque in every condition leave less light than this; 0 never ends it."""

    def __post_init__(self):
        if self.candidates < 1:
            raise UserError(f"march.candidates is {self.candidates}: use at least 1")
        if not 0 < self.even_distance < math.inf:
            raise UserError(f"march.even_distance is {self.even_distance}: use a positive number of metres")
        if not 0 <= self.near < math.inf:
            raise UserError(f"march.near is {self.near}: use 0 or a positive number of metres")
        if not 0 <= self.stop_transmittance < 1:
            raise UserError(f"march.stop_transmittance is {self.stop_transmittance}: use 0 or more and less than 1")


@dataclass(frozen=True)
class Samples:
    """Samples of rays, front to back, padded to the longest ray; a padded place has t = dt = 0 and mask False."""

    t: Float[Tensor, "rays samples"]
    dt: Float[Tensor, "rays samples"]
    mask: Bool[Tensor, "rays samples"]


def candidates(
    near: Float[Tensor, " rays"],
    far: Float[Tensor, " rays"],
    settings: MarchSettings,
    generator: torch.Generator | None,
) -> tuple[Float[Tensor, "rays candidates"], Float[Tensor, "rays candidates"]]:
    """Return t and dt (m) of the candidates between near and far: interval middles, or random with a generator."""
    count, c = settings.candidates, settings.even_distance
    steps = torch.arange(count, device=near.device, dtype=near.dtype)
    start = (near + c)[:, None]
    growth = torch.log(far + c)[:, None] - torch.log(start)
    if generator is None:
        place = (steps + 0.5).expand(len(near), count)
    else:
        place = steps + torch.rand(len(near), count, generator=generator, device=near.device, dtype=near.dtype)
    # expm1 of differences, not differences of exp: near a far camera the intervals would drown in rounding
    t = near[:, None] + start * torch.expm1(place * (growth / count))
    dt = start * torch.exp(steps * (growth / count)) * torch.expm1(growth / count)
    return t, dt


@torch.no_grad()
def march(
    rays: Rays, occupancy: OccupancyGrid, settings: MarchSettings, generator: torch.Generator | None = None
) -> Samples:
    """Sample rays where the grid is occupied and not hidden behind what is always opaque; jittered with a generator."""
    near, far, hit = intersect_box(rays.origins, rays.directions, occupancy.box, settings.near)
    t, dt = candidates(near, far, settings, generator)
    positions = rays.origins[:, None] + rays.directions[:, None] * t[:, :, None]
    extinction = occupancy.extinction()[occupancy.cell_index(positions.view(-1, 3))].view_as(t)
    mask = (extinction >= 0) & (dt > 0) & hit[:, None]
    if settings.stop_transmittance > 0:
        thickness = extinction.clamp(min=0) * dt
        before = (
            torch.cumsum(thickness, dim=1) - thickness
        )  # a rounding error here moves the end by nothing that counts
        mask &= before <= -math.log(settings.stop_transmittance)
    return _compact(t, dt, mask)


def _compact(t: Tensor, dt: Tensor, mask: Tensor) -> Samples:
    """Move the samples that stay to the front of their rows and cut the rows to the longest."""
    count = mask.sum(dim=1)
    width = int(count.max()) if len(count) else 0
    kept = torch.arange(width, device=t.device) < count[:, None]
    # a boolean mask reads and writes row by row, front to back: the order along each ray stays
    front_t, front_dt = t.new_zeros(kept.shape), t.new_zeros(kept.shape)
    front_t[kept], front_dt[kept] = t[mask], dt[mask]
    return Samples(front_t, front_dt, kept)
