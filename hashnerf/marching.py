"""Sample positions along rays: a fixed number of candidates between box entry and exit, of which some are kept.

Candidates are stratified: interval edges are evenly spaced in log(t + c), so they grow in proportion to the distance t
from the camera beyond about c metres. One candidate lies in each interval, at its middle or at random. With
`samples: 0` every candidate in an occupied cell is kept; otherwise at most `samples` are drawn from the occupied ones,
in proportion to the opacity that the occupancy grid leads to expect there.
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

MOST_SAMPLES_PER_OPACITY = 1e6
MOST_HIDDEN = 1.0  # optical thickness an interval is trusted to have: a ray may pass beside what fills half a cell
FLOOR = 0.5  # opacity added to all occupied intervals of a ray together, so that none is ever left out


@dataclass(frozen=True)
class MarchSettings:
    """How rays are sampled."""

    candidates: int = 96
    """Positions tried along a ray between entering and leaving the scene box."""
    even_distance: float = 20.0
    """Up to about this distance (m) positions are evenly spaced, beyond it the spacing grows with distance."""
    near: float = 0.05
    """Nothing closer to the camera than this (m) is sampled."""
    samples: int = 48
    """Most samples of a ray, drawn where opacity is expected; 0 takes every occupied candidate instead."""
    samples_per_opacity: float = 8.0
    """Samples for each interval expected to be opaque."""
    stop_transmittance: float = 1e-3
    """A ray ends where cells known opaque in every condition leave less light than this; 0 never ends it."""

    def __post_init__(self):
        if self.candidates < 1:
            raise UserError(f"march.candidates is {self.candidates}: use at least 1")
        if self.samples < 0:
            raise UserError(f"march.samples is {self.samples}: use 0 or more")
        if not 0 < self.samples_per_opacity <= MOST_SAMPLES_PER_OPACITY:
            raise UserError(f"march.samples_per_opacity is {self.samples_per_opacity}: use a positive number up to 1e6")
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


def intervals(
    near: Float[Tensor, " rays"], far: Float[Tensor, " rays"], settings: MarchSettings
) -> tuple[Float[Tensor, "rays candidates"], Float[Tensor, "rays candidates"]]:
    """Return start and length (m) of the intervals between near and far."""
    steps = torch.arange(settings.candidates, device=near.device, dtype=near.dtype)
    near, scale = near[:, None], (near + settings.even_distance)[:, None]
    # log1p and expm1 of small numbers, not differences of log and exp: short intervals would drown in rounding
    growth = torch.log1p((far[:, None] - near) / scale) / settings.candidates
    grown = torch.expm1(steps * growth)
    return torch.addcmul(near, scale, grown), (grown + 1).mul_(scale * torch.expm1(growth))


def _uniform(like: Tensor, generator: torch.Generator | None) -> Tensor:
    """Random numbers in [0, 1), or the middle without a generator."""
    if generator is None:
        return torch.full_like(like, 0.5)
    return torch.rand(like.shape, generator=generator, device=like.device, dtype=like.dtype)


@torch.no_grad()
def march(
    rays: Rays, occupancy: OccupancyGrid, settings: MarchSettings, generator: torch.Generator | None = None
) -> Samples:
    """Sample rays where the grid is occupied and not hidden behind what is always opaque; jittered with a generator."""
    near, far, hit = intersect_box(rays.origins, rays.directions, occupancy.box, settings.near)
    start, dt = intervals(near, far, settings)
    # resampling draws again within each interval, so there the look-up needs no more than one number a ray
    shift = _uniform(dt if not settings.samples else dt[:, :1], generator)
    t = torch.addcmul(start, dt, shift)
    highest, lowest, usual = occupancy.densities_along(rays, t)
    mask = (highest > 0) & (hit & (far > near))[:, None]
    if bool(lowest.any()):
        thickness = lowest.mul_(dt)
        # exclusive by subtraction: rounding moves a ray's end by nothing that counts
        before = torch.cumsum(thickness, dim=1).sub_(thickness)
    else:
        before = torch.zeros_like(dt)
    if settings.stop_transmittance > 0:
        mask &= before <= -math.log(settings.stop_transmittance)
    if not settings.samples:
        return _compact(t, dt, mask)
    hidden = usual.mul_(dt).clamp_(max=MOST_HIDDEN)
    hidden = torch.cumsum(hidden, dim=1).sub_(hidden)
    expected = torch.expm1(highest.mul_(dt).neg_()).neg_().mul_(torch.exp(hidden.neg_()))
    return _resample(start, dt, expected, mask, settings, generator)


def _compact(t: Tensor, dt: Tensor, mask: Tensor) -> Samples:
    """Move the samples that stay to the front of their rows and cut the rows to the longest."""
    count = mask.sum(dim=1)
    width = int(count.max()) if len(count) else 0
    kept = torch.arange(width, device=t.device) < count[:, None]
    # a boolean mask reads and writes row by row, front to back: the order along each ray stays
    front_t, front_dt = t.new_zeros(kept.shape), t.new_zeros(kept.shape)
    front_t[kept], front_dt[kept] = t[mask], dt[mask]
    return Samples(front_t, front_dt, kept)


def _resample(
    start: Tensor,
    dt: Tensor,
    expected: Tensor,
    mask: Tensor,
    settings: MarchSettings,
    generator: torch.Generator | None,
) -> Samples:
    """Draw samples in proportion to the visible opacity expected of each interval, more of them the more there is.

    A sample drawn with density p (1/m) among n stands for a length 1/(n p), so every sample has about the same optical
    thickness and the integral along the ray stays right whatever the expectation was.
    """
    evenly = FLOOR / dt.sum(dim=1, keepdim=True).clamp(min=1e-12)
    importance = torch.addcmul(expected, dt, evenly).mul_(mask)
    cumulative = torch.cumsum(importance, dim=1)
    total = cumulative[:, -1:]
    count = (total * settings.samples_per_opacity + 1).ceil().clamp(max=settings.samples) * (total > 0)
    width = int(count.max()) if len(dt) else 0
    place = torch.arange(width, device=dt.device, dtype=dt.dtype).expand(len(dt), width)
    kept = place < count
    wanted = (place + _uniform(place, generator)) / count.clamp(min=1) * total
    interval = torch.searchsorted(cumulative, wanted, right=True).clamp(max=dt.shape[1] - 1)
    mass, length = importance.gather(1, interval), dt.gather(1, interval)
    kept &= mass > 0
    mass = torch.where(kept, mass, 1.0)
    inside = ((wanted - cumulative.gather(1, interval)) / mass + 1).clamp(0, 1)
    t = start.gather(1, interval) + inside * length
    new_dt = length * total / (count.clamp(min=1) * mass)
    return Samples(torch.where(kept, t, 0.0), torch.where(kept, new_dt, 0.0), kept)
