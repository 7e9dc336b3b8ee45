"""Sample positions along rays: a fixed number of candidates between box entry and exit, of which some are kept.

Candidates are stratified: interval edges are evenly spaced in log(t + c), so they grow in proportion to the distance t
from the camera beyond about c metres. One candidate lies in each interval, at its middle or at random. With
`samples: 0` every candidate in an occupied cell is kept; otherwise at most `samples` are drawn from the occupied ones,
in proportion to the opacity that the occupancy grid leads to expect there. With `guided_per_opacity` the field's own
density decides in a second round, at a fraction of the cost of a sample with colour and gradient.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from hashnerf.errors import UserError
from hashnerf.occupancy import OccupancyGrid
from hashnerf.ray_box import intersect_box
from hashnerf.rays import Rays
from hashnerf.resampling import Samples, Strata, cut_pieces, draw_samples, uniform

MOST_SAMPLES_PER_OPACITY = 1e6
MOST_PLACES = 1 << 20  # on a ray
FARTHEST = 1e12  # metres: their squares are numbers
MOST_HIDDEN = 1.0  # optical thickness an interval is trusted to have: a ray may pass beside what fills half a cell

DensityFn = Callable[[Tensor, Tensor], Tensor]
"""Density (1/m, [s]) of positions ([s, 3], m) on rays of some numbers ([s])."""


@dataclass(frozen=True)
class MarchSettings:
    """How rays are sampled."""

    candidates: int = 96
    """Positions tried along a ray between entering and leaving the scene box; 0 derives it from the scene."""
    even_distance: float = 20.0
    """Up to about this distance (m) positions are evenly spaced, beyond it the spacing grows with distance; 0 derives
    it from the scene."""
    near: float = 0.05
    """Nothing closer to the camera than this (m) is sampled."""
    samples: int = 48
    """Most samples of a ray, drawn where opacity is expected; 0 takes every occupied candidate instead."""
    samples_per_opacity: float = 8.0
    """Samples for each interval expected to be opaque."""
    guided_per_opacity: float = 0.0
    """With a positive number rays are sampled twice: the samples above say where the field's density alone is asked
    for, without gradients, and this many are then drawn for each opaque stretch that it shows; 0 samples once."""
    stop_transmittance: float = 1e-3
    """A ray ends where cells known opaque in every condition leave less light than this; 0 never ends it."""

    def __post_init__(self):
        if not 0 <= self.candidates <= MOST_PLACES:
            raise UserError(
                f"march.candidates is {self.candidates}: use 1 to {MOST_PLACES}, or 0 to derive it from the scene"
            )
        if not 0 <= self.samples <= MOST_PLACES:
            raise UserError(f"march.samples is {self.samples}: use 0 to {MOST_PLACES}")
        if not 0 < self.samples_per_opacity <= MOST_SAMPLES_PER_OPACITY:
            raise UserError(f"march.samples_per_opacity is {self.samples_per_opacity}: use a positive number up to 1e6")
        if not 0 <= self.guided_per_opacity <= MOST_SAMPLES_PER_OPACITY:
            raise UserError(f"march.guided_per_opacity is {self.guided_per_opacity}: use 0 or a number up to 1e6")
        if self.guided_per_opacity and not self.samples:
            raise UserError("march.guided_per_opacity needs samples to look at first: use march.samples of 1 or more")
        if not 0 <= self.even_distance <= FARTHEST:
            raise UserError(
                f"march.even_distance is {self.even_distance}: use a positive number of metres up to {FARTHEST:g}, "
                "or 0 to derive it"
            )
        if not 0 <= self.near <= FARTHEST:
            raise UserError(f"march.near is {self.near}: use 0 or a positive number of metres up to {FARTHEST:g}")
        if not 0 <= self.stop_transmittance < 1:
            raise UserError(f"march.stop_transmittance is {self.stop_transmittance}: use 0 or more and less than 1")


def intervals(
    near: Float[Tensor, " rays"], far: Float[Tensor, " rays"], settings: MarchSettings
) -> tuple[Float[Tensor, "rays candidates"], Float[Tensor, "rays candidates"]]:
    """Return start and length (m) of the intervals between near and far; ValueError for settings that are left open."""
    if not settings.candidates or not settings.even_distance:
        raise ValueError("march.candidates and march.even_distance are 0: use fitted_to_scene first")
    steps = torch.arange(settings.candidates, device=near.device, dtype=near.dtype)
    near, scale = near[:, None], (near + settings.even_distance)[:, None]
    # log1p and expm1 of small numbers, not differences of log and exp: short intervals would drown in rounding
    growth = torch.log1p((far[:, None] - near) / scale) / settings.candidates
    grown = torch.expm1(steps * growth)
    return torch.addcmul(near, scale, grown), (grown + 1).mul_(scale * torch.expm1(growth))


@torch.no_grad()
def march(
    rays: Rays,
    occupancy: OccupancyGrid,
    settings: MarchSettings,
    generator: torch.Generator | None = None,
    density_fn: DensityFn | None = None,
    look_at_ends: bool = False,
) -> Samples:
    """Sample rays where the grid is occupied and not hidden behind what is always opaque; jittered with a generator.

    `density_fn` is asked where `settings.guided_per_opacity` wants it; without one rays are sampled once. What is usual
    in front of a surface may not be there: a ray that skims a road passes over many cells that touch the asphalt. With
    `look_at_ends` a ray is looked at where it is known to end whatever is usual in front.
    """
    if occupancy.is_empty():
        nothing = rays.origins.new_zeros(len(rays), 0)
        return Samples(nothing, nothing, nothing.bool())
    near, far, hit = intersect_box(rays.origins, rays.directions, occupancy.box, settings.near)
    start, dt = intervals(near, far, settings)
    # resampling draws again within each interval, so there the look-up needs no more than one number a ray
    shift = uniform(dt if not settings.samples else dt[:, :1], generator)
    t = torch.addcmul(start, dt, shift)
    highest, lowest, usual = occupancy.densities_along(rays, t)
    mask = (highest > 0) & (hit & (far > near))[:, None]
    if bool(lowest.any()):
        thickness = lowest.mul_(dt)
        # exclusive by subtraction: rounding moves a ray's end by nothing that counts
        before = torch.cumsum(thickness, dim=1).sub_(thickness)
        certain = torch.expm1(-thickness).neg_().mul_(torch.exp(-before)) if look_at_ends else None
    else:
        before, certain = torch.zeros_like(dt), None
    if settings.stop_transmittance > 0:
        mask &= before <= -math.log(settings.stop_transmittance)
    if not settings.samples:
        return _compact(t, dt, mask)
    hidden = usual.mul_(dt).clamp_(max=MOST_HIDDEN)
    hidden = torch.cumsum(hidden, dim=1).sub_(hidden)
    expected = torch.expm1(highest.mul_(dt).neg_()).neg_().mul_(torch.exp(hidden.neg_()))
    if certain is not None:
        expected = torch.maximum(expected, certain)
    strata = Strata.of(start, dt, expected, mask, settings.samples_per_opacity, settings.samples)
    if density_fn is None or not settings.guided_per_opacity:
        return draw_samples(strata, generator)
    return _guided(rays, Samples(*cut_pieces(strata)), settings, generator, density_fn)


def _guided(
    rays: Rays,
    pieces: Samples,
    settings: MarchSettings,
    generator: torch.Generator | None,
    density_fn: DensityFn,
) -> Samples:
    """Sample pieces of rays in proportion to the light that the field's own density stops there or beside it."""
    start, dt, mask = pieces.t, pieces.dt, pieces.mask
    place, ray = pieces.places()
    if not len(place):
        return pieces
    t = torch.addcmul(start, dt, uniform(dt, generator)).view(-1)[place]
    density = density_fn(rays.origins[ray] + rays.directions[ray] * t[:, None], ray).to(dt.dtype)
    # a broken density is the loss's to report: here it only must not spoil the places
    density = torch.where(density.isfinite(), density, 0.0)
    thickness = torch.zeros_like(dt).view(-1).index_copy_(0, place, density).view(dt.shape).mul_(dt)
    before = torch.cumsum(thickness, dim=1).sub_(thickness)
    stopped = torch.exp(-before).mul_(torch.expm1(-thickness).neg_())
    # one look into a piece may miss a surface at its border, so what is found counts for both neighbours, too
    beside = nn.functional.max_pool1d(nn.functional.pad(stopped[:, None], (1, 1)), 3, 1)[:, 0]
    share = stopped.sum(dim=1, keepdim=True) / beside.sum(dim=1, keepdim=True).clamp(min=1e-6)
    return draw_samples(
        Strata.of(start, dt, beside.mul(share), mask, settings.guided_per_opacity, settings.samples), generator
    )


def _compact(t: Tensor, dt: Tensor, mask: Tensor) -> Samples:
    """Move the samples that stay to the front of their rows and cut the rows to the longest."""
    count = mask.sum(dim=1)
    width = int(count.max()) if len(count) else 0
    kept = torch.arange(width, device=t.device) < count[:, None]
    # a boolean mask reads and writes row by row, front to back: the order along each ray stays
    front_t, front_dt = t.new_zeros(kept.shape), t.new_zeros(kept.shape)
    front_t[kept], front_dt[kept] = t[mask], dt[mask]
    return Samples(front_t, front_dt, kept)
