"""Volume rendering of rays through callables: the core knows neither conditions nor networks.

A field is any `field_fn(positions [s,3] m, directions [s,3] unit, ray_index [s]) -> (density [s] 1/m, rgb [s,3] in
[0,1])`; a background is any `background_fn(rays) -> rgb [rays,3]`, black if absent. Depth is the
distance along the ray in metres, not the depth along the optical axis.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.profiler import record_function

from hashnerf.cameras import Cameras, image_rays
from hashnerf.compositing import composite_colour, expected_depth, median_depth, sample_weights
from hashnerf.marching import DensityFn, MarchSettings, march
from hashnerf.occupancy import OccupancyGrid
from hashnerf.rays import Rays, joined

FieldFn = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]
BackgroundFn = Callable[[Rays], Tensor]
EDGE = 2.0  # distances within a pixel whose ratio is greater belong to different surfaces
MARCH, FIELD = "march", "field at the samples"  # as a profile names them
RAYS_AT_ONCE = 8192  # of pictures
SAMPLES_AT_ONCE = 1 << 17  # without gradients the field sees this many samples at a time


@dataclass(frozen=True)
class Rendering:
    """What rays see."""

    rgb: Float[Tensor, "rays 3"]
    """Colour in [0, 1], background included."""
    depth: Float[Tensor, " rays"]
    """Mean distance of what the ray hits (m), inf where it hits nothing."""
    median_depth: Float[Tensor, " rays"]
    """Distance at which half of the light is stopped (m), inf where that never happens."""
    depth_valid: Bool[Tensor, " rays"]
    """Whether the ray hits anything; without it depth means nothing."""
    opacity: Float[Tensor, " rays"]
    """Share of the light stopped inside the box."""
    samples_evaluated: int
    """Samples the field was asked for."""


def render(
    rays: Rays,
    field_fn: FieldFn,
    occupancy: OccupancyGrid,
    settings: MarchSettings,
    background_fn: BackgroundFn | None = None,
    generator: torch.Generator | None = None,
    density_fn: DensityFn | None = None,
    look_at_ends: bool = False,
) -> Rendering:
    """Render rays; sample positions are jittered with a generator, interval middles without.

    `density_fn` is the field's density alone, for marching that is guided by it; `look_at_ends` is as in `march`.
    """
    with record_function(MARCH):
        samples = march(rays, occupancy, settings, generator, density_fn, look_at_ends)
    shape = samples.mask.shape
    place, ray_index = samples.places()
    directions = rays.directions[ray_index]
    positions = rays.origins[ray_index] + directions * samples.t.view(-1)[place, None]
    with record_function(FIELD):
        density, rgb = _evaluate(field_fn, positions, directions, ray_index)
    density = density.new_zeros(shape.numel()).index_copy(0, place, density).view(shape)
    rgb = rgb.new_zeros(shape.numel(), 3).index_copy(0, place, rgb).view(*shape, 3)
    weights, _ = sample_weights(density, samples.dt)
    background = torch.zeros_like(rays.directions) if background_fn is None else background_fn(rays)
    depth, valid = expected_depth(weights, samples.t)
    median, _ = median_depth(weights, samples.t)
    colour = composite_colour(weights, rgb, background)
    return Rendering(colour, depth, median, valid, weights.sum(dim=1).clamp(max=1), len(place))


def _evaluate(field_fn: FieldFn, positions: Tensor, directions: Tensor, ray_index: Tensor) -> tuple[Tensor, Tensor]:
    if torch.is_grad_enabled() or len(positions) <= SAMPLES_AT_ONCE:
        return field_fn(positions, directions, ray_index)
    parts = zip(*(value.split(SAMPLES_AT_ONCE) for value in (positions, directions, ray_index)))
    density, rgb = zip(*(field_fn(*part) for part in parts))
    return torch.cat(density), torch.cat(rgb)


@torch.no_grad()
def render_images(
    cameras: Cameras,
    indices: Sequence[int],
    field_fn: FieldFn,
    occupancy: OccupancyGrid,
    settings: MarchSettings,
    background_fn: BackgroundFn | None = None,
    rays_at_once: int = RAYS_AT_ONCE,
    density_fn: DensityFn | None = None,
    supersample: int = 1,
) -> Rendering:
    """Render every pixel of some cameras (rows n*h*w, row-major) without gradients, a chunk of rays at a time.

    Small pictures share a chunk: a few thousand rays together take less time than in several calls. A pixel is the
    mean over an area: with `supersample` k it gets k*k rays, evenly spaced, and their mean colour.
    """
    height, width = cameras.height, cameras.width
    finer = cameras.scaled(width * supersample, height * supersample)
    rays = joined([image_rays(finer, index) for index in indices])
    chunks = [
        render(
            rays.select(slice(start, start + rays_at_once)),
            field_fn,
            occupancy,
            settings,
            background_fn,
            None,
            density_fn,
            look_at_ends=True,  # for pictures; fields that are trained with it are a little worse (docs/results)
        )
        for start in range(0, len(rays), rays_at_once)
    ]
    whole = {f.name: torch.cat([getattr(c, f.name) for c in chunks]) for f in fields(Rendering)[:-1]}
    seen = Rendering(**whole, samples_evaluated=sum(chunk.samples_evaluated for chunk in chunks))
    return seen if supersample == 1 else _pooled(seen, len(indices) * height, width, supersample)


def _pooled(seen: Rendering, height: int, width: int, finer: int) -> Rendering:
    """Return pixels of finer x finer rays each."""

    def rays_of(values: Tensor) -> Tensor:
        parts = values.view(height, finer, width, finer, -1).transpose(1, 2)
        return parts.reshape(height * width, finer * finer, -1)

    depth, median = (middle_distance(rays_of(values)[:, :, 0]) for values in (seen.depth, seen.median_depth))
    rgb, opacity = rays_of(seen.rgb).mean(dim=1), rays_of(seen.opacity)[:, :, 0].mean(dim=1)
    return Rendering(rgb, depth, median, depth.isfinite(), opacity, seen.samples_evaluated)


def middle_distance(distances: Float[Tensor, "pixels rays"]) -> Float[Tensor, " pixels"]:
    """Return the distance (m) in the middle of each pixel's rays, inf where most of them hit nothing.

    The inverse of the distance is almost linear across the picture of a plane, so of an even number of rays the mean
    inverse of the middle two is the pixel's centre. Two that are far apart lie on both sides of an edge, between which
    nothing is: there the nearer one counts.
    """
    inverse = (1 / distances).sort(dim=1).values
    count = inverse.shape[1]
    farther, nearer = inverse[:, (count - 1) // 2], inverse[:, count // 2]
    return 1 / torch.where(nearer > EDGE * farther, nearer, (nearer + farther) / 2)
