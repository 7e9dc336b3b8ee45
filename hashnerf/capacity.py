"""How much of a radiance field a scene requires, read off its pictures before any training.

Is there anything? Not if a sky that depends on direction alone shows the pictures as well. How fine? A cell need not be
finer than what a pixel covers where the cameras look (the *footprint*, depth over focal length), nor finer than the
coarsest pixels that would show the pictures as well. How many table entries? One *texel* is a pixel's footprint of
surface; texels are the pixels that show anything, divided by the number of pictures that share each point. How many
samples? As many as a ray crosses cells of the occupancy grid.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

from hashnerf.background_only import background_alone
from hashnerf.cameras import Cameras, camera_rays
from hashnerf.field import FieldConfig
from hashnerf.marching import MarchSettings
from hashnerf.occupancy import OccupancyConfig
from hashnerf.progress import say
from hashnerf.ray_box import intersect_box
from hashnerf.visible_volume import box_lattice, evenly, visible_points

LATTICE = 20
"""Points along each side of the box that are looked for in the pictures."""
MOST_PICTURES = 64
"""Pictures that are looked at, evenly chosen."""
DETAIL_DB = 40.0
"""Pictures that agree this well with themselves at a lower resolution need no more of it."""
EMPTY_DB, EMPTY_BLOCK_DB = 40.0, 28.0
"""Pictures that a background shows this well, on average and in the worst block, show nothing that stands anywhere."""
COARSEST = 64
"""Most by which the pixels are enlarged in search of detail."""
PLAIN = 2 / 255
"""Blocks of pixels whose colours stay within this of their mean show nothing but the noise of the last bits."""
BLOCK = 8
"""Side of such a block, pixels."""
GROWTH = 1.5
"""Resolution of a level over that of the one before (as in Instant-NGP: 1.26 to 2)."""
VERTICES_PER_TEXEL = 2.0
"""A surface runs between two layers of vertices."""
OCCUPANCY_CELLS = 1 << 18
"""Cells of the occupancy grid: to ask all of them for their density costs about as much as a few training steps."""
CANDIDATES_PER_CELL = 1.5
"""Positions tried on the way through an occupancy cell."""
NEARER = 0.05
"""Share of the views that are near enough to show details: few, as cameras that stand in a scene see most of it from
afar (docs/results/core_notes.md)."""
CLEAR = 1e-3
"""Optical thickness of the box before training where it is taken for empty."""
COARSE = 8
"""Occupancy cells along such a box."""
FEWEST_ENTRIES, MOST_ENTRIES = 8, 24
"""Binary logarithms."""
FEWEST_CANDIDATES, MOST_CANDIDATES = 16, 256
RAYS = 4096
"""Rays whose way through the box is measured."""


@dataclass(frozen=True)
class SceneMeasures:
    """What pictures show, metres."""

    footprint: float
    """What a pixel covers of the places it shows, in the nearest of all views of a place."""
    distance: float
    """From the cameras to the places that they show, the median."""
    enlargement: int
    """How many times larger pixels could be and still show the pictures."""
    texels: float
    """Pixels of surface that show anything, each counted once however many pictures show it."""
    chord: float
    """The way of a pixel's ray through the box, 90 % are shorter."""


@runtime_checkable
class Capacities(Protocol):
    """Settings of a radiance field of any pipeline: a frozen dataclass with these three parts."""

    field: FieldConfig
    occupancy: OccupancyConfig
    march: MarchSettings


Settings = TypeVar("Settings", bound=Capacities)

OPEN = {
    "field": ("levels", "log2_table_size", "finest_resolution"),
    "occupancy": ("cell",),
    "march": ("candidates", "even_distance"),
}
"""What settings may leave open, as 0."""


def measure_scene(images: UInt8[Tensor, "n h w 3"], cameras: Cameras, box: Float[Tensor, "2 3"]) -> SceneMeasures:
    """Looks at pictures and at what their cameras see of a box (metres)."""
    count = len(cameras)
    rows = evenly(count, MOST_PICTURES)
    chosen, pictures = cameras.select(rows), images[rows]
    seen, depth = visible_points(chosen, box_lattice(box, LATTICE))
    if not bool(seen.any()):  # a box between the cameras' lines of sight: its middle is all that is known
        distance = nearer = float((cameras.pose[:, :3, 3] - box.mean(dim=0)).norm(dim=1).median())
        shared = 1.0
    else:
        nearer, distance = np.quantile(depth[seen].numpy(), [NEARER, 0.5]).tolist()
        shared = float(seen.sum(dim=0)[seen.any(dim=0)].float().mean()) * count / len(rows)
    pixels = count * images.shape[1] * images.shape[2]
    return SceneMeasures(
        nearer / float(cameras.focal.mean()),
        distance,
        enlargement(pictures),
        max(1.0, pixels * structured_share(pictures) / shared * (distance / nearer) ** 2),
        _chord(chosen, box),
    )


def is_open(settings: Capacities) -> bool:
    """Returns whether settings leave anything to be derived from the pictures."""
    return any(not getattr(getattr(settings, part), name) for part, names in OPEN.items() for name in names)


def fitted_to_scene(
    settings: Settings, images: UInt8[Tensor, "n h w 3"], cameras: Cameras, box: Float[Tensor, "2 3"]
) -> tuple[Settings, str]:
    """Returns settings with what they leave open (0) derived from pictures of a box (metres), and why, in one line.

    What they state stays, but for `field.initial_thickness` where nothing stands in the box: that starts in clear air.
    Raises UserError where what is stated leaves no room for `field.initial_thickness`.
    """
    alone = background_alone(images, cameras, box, settings.field.direction_degree, settings.field.sky_width)
    if alone.mean_db >= EMPTY_DB and alone.worst_block_db >= EMPTY_BLOCK_DB:
        return _empty(settings, box, alone.mean_db)
    scene = measure_scene(images, cameras, box)
    field, sides = settings.field, (box[1] - box[0]).double()
    longest = float(sides.amax())
    finest = field.finest_resolution or max(2, math.ceil(longest / (scene.footprint * scene.enlargement)))
    base = min(field.base_resolution, finest)
    levels = field.levels or 1 + math.ceil(math.log(finest / base) / math.log(GROWTH) - 1e-9)
    texels = max(1.0, scene.texels / scene.enlargement**2)
    entries = math.ceil(math.log2(VERTICES_PER_TEXEL * texels))
    entries = field.log2_table_size or min(max(entries, FEWEST_ENTRIES), MOST_ENTRIES)
    cell = settings.occupancy.cell or _occupancy_cell(sides.tolist(), longest / finest)
    crossed = math.ceil(min(CANDIDATES_PER_CELL * scene.chord / cell, MOST_CANDIDATES))
    candidates = settings.march.candidates or max(crossed, FEWEST_CANDIDATES)
    reason = (
        f"capacity: pixels cover {scene.footprint:.3g} m of places about {scene.distance:.3g} m away, could be "
        f"{scene.enlargement} x larger, and about {texels:.2g} of them show surface: {levels} levels, "
        f"{finest} cells along {longest:.3g} m, 2^{entries} entries a level; occupancy cells of {cell:.2g} m, "
        f"{candidates} candidates a ray"
    )
    return replace(
        settings,
        field=replace(field, levels=levels, finest_resolution=finest, base_resolution=base, log2_table_size=entries),
        occupancy=replace(settings.occupancy, cell=cell),
        march=replace(
            settings.march, candidates=candidates, even_distance=settings.march.even_distance or _short(scene.distance)
        ),
    ), reason


def _occupancy_cell(sides: list[float], finest: float) -> float:
    """The edge (m) that gives about as many cells as wanted, no finer than the field's."""
    cell = max((math.prod(sides) / OCCUPANCY_CELLS) ** (1 / 3), finest)
    while math.prod(math.ceil(side / cell) for side in sides) > 2 * OCCUPANCY_CELLS:
        cell *= 1.1  # in a box thinner than a cell the volume misleads
    return _short(cell)


def _short(value: float) -> float:
    """A number that people can read in a config."""
    return float(f"{value:.4g}")


def _empty(settings: Settings, box: Tensor, alone: float) -> tuple[Settings, str]:
    """The least there can be, in clear air: its density says at once that no ray needs a sample."""
    longest = float((box[1] - box[0]).amax())
    field, occupancy, march = settings.field, settings.occupancy, settings.march
    finest = field.finest_resolution or 2
    field = replace(
        field,
        levels=field.levels or 1,
        finest_resolution=finest,
        base_resolution=min(field.base_resolution, finest),
        log2_table_size=field.log2_table_size or FEWEST_ENTRIES,
        initial_thickness=min(field.initial_thickness, CLEAR),
    )
    reason = f"capacity: a sky by direction alone shows the pictures with {alone:.1f} dB, so the box is taken for empty"
    return replace(
        settings,
        field=field,
        occupancy=replace(occupancy, cell=occupancy.cell or _short(longest / COARSE)),
        march=replace(
            march,
            candidates=march.candidates or FEWEST_CANDIDATES,
            even_distance=march.even_distance or _short(longest),
        ),
    ), reason


def with_capacity(
    settings: Settings,
    stored: Mapping[str, Any] | None,
    images: UInt8[Tensor, "n h w 3"],
    cameras: Cameras,
    box: Float[Tensor, "2 3"],
) -> Settings:
    """Returns settings with nothing left open: as `stored` by a training that was begun, else derived, and said why."""
    if not is_open(settings):
        return settings
    if stored is not None:
        return filled_from(settings, stored)
    full, reason = fitted_to_scene(settings, images, cameras, box)
    say(reason)
    return full


def filled_from(settings: Settings, stored: Mapping[str, Any]) -> Settings:
    """Returns settings with what they leave open taken from stored ones: those that a field was trained with."""
    parts = {}
    for part, names in OPEN.items():
        own = getattr(settings, part)
        left = [name for name in names if not getattr(own, name)]
        if part == "field" and left:
            left += ["base_resolution", "initial_thickness"]  # derived along with the others
        elif part == "field" and stored[part]["initial_thickness"] == min(own.initial_thickness, CLEAR):
            left = ["initial_thickness"]  # the box was taken for empty, whatever was stated
        parts[part] = replace(own, **{name: stored[part][name] for name in left})
    return replace(settings, **parts)


def enlargement(images: UInt8[Tensor, "n h w 3"]) -> int:
    """Returns by how much (a power of two) pixels can grow until what the pictures show loses more than allowed.

    The error counts over the blocks that show anything: a small thing before a wide sky must not be lost.
    """
    factor, shown = 1, max(structured_share(images), BLOCK**2 / images[..., 0].numel())
    while 2 * factor <= min(COARSEST, *images.shape[1:3]):
        lost = sum(_lost(picture, 2 * factor) for picture in _pictures(images)) / (len(images) * shown)
        if lost > 10 ** (-DETAIL_DB / 10):
            break
        factor *= 2
    return factor


def _lost(picture: Float[Tensor, "1 3 h w"], factor: int) -> float:
    """Mean squared error of a picture against itself with larger pixels."""
    coarse = avg_pool2d(picture, factor, ceil_mode=True, count_include_pad=False)
    again = interpolate(coarse, scale_factor=factor, mode="bilinear")[..., : picture.shape[2], : picture.shape[3]]
    return float((again - picture).square().mean())


def structured_share(images: UInt8[Tensor, "n h w 3"]) -> float:
    """Returns the share of the pictures' area whose blocks of 8 x 8 pixels are not of one colour."""
    return float(np.mean([_structured(picture) for picture in _pictures(images)]))


def _structured(picture: Float[Tensor, "1 3 h w"]) -> float:
    mean = avg_pool2d(picture, BLOCK, ceil_mode=True, count_include_pad=False)
    square = avg_pool2d(picture.square(), BLOCK, ceil_mode=True, count_include_pad=False)
    spread = (square - mean.square()).clamp(min=0).sqrt().amax(dim=1)
    return float((spread > PLAIN).float().mean())


def _pictures(images: UInt8[Tensor, "n h w 3"]) -> Iterator[Float[Tensor, "1 3 h w"]]:
    """Pictures one after another: all as numbers at once would be gigabytes."""
    for picture in images:
        yield picture.permute(2, 0, 1)[None].float() / 255


def _chord(cameras: Cameras, box: Tensor) -> float:
    generator = torch.Generator().manual_seed(0)
    number = torch.randint(len(cameras), (RAYS,), generator=generator)
    pixel = torch.rand(RAYS, 2, generator=generator) * torch.tensor([float(cameras.width), float(cameras.height)])
    rays = camera_rays(cameras, number, pixel)
    near, far, hit = intersect_box(rays.origins, rays.directions, box)
    inside = (far - near)[hit]
    return float(torch.quantile(inside, 0.9)) if len(inside) else float((box[1] - box[0]).amax())
