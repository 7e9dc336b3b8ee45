"""The road network: centre lines with a width, a height and a colour, as `road_network` in transforms.json tells them.

    "road_network": {"lines": [[[x, y], ...], ...], "width": m, "height": m (optional, 0),
                     "colour": [r, g, b] of 0..255, or one such triple per line}

World frame, metres. Lines that form one town meet: the network must be connected. On ground that is not level all
points are [x, y, z], and no height is told. The entry may also stand in a JSON file of its own.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from hashnerf.errors import UserError
from hashnerf.transforms_json import read_json

FARTHEST = 1e8
"""Metres from 0 beyond which no map projection has a point."""
EARTH_RADIUS = 6_371_008.8
"""Mean radius of the Earth, metres."""


@dataclass(frozen=True)
class RoadNetwork:
    """Roads of one width; colours are in [0, 1], one per line."""

    lines: tuple[Float[Tensor, "_ 2"], ...]
    width: float
    height: float
    """Metres; on ground that is not level the median of `heights`."""
    colours: Float[Tensor, "lines 3"]
    heights: tuple[Float[Tensor, " _"], ...] | None = None
    """Metres of every point of every line; None on level ground."""

    @property
    def length(self) -> float:
        """Metres of all lines together."""
        return float(sum(_lengths(line).sum() for line in self.lines))

    def distance(self, points: Float[Tensor, "n 2"]) -> Float[Tensor, " n"]:
        """Distance of each point to the nearest centre line, metres."""
        return self.nearest(points)[1]

    def sample(self, count: int, generator: torch.Generator) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 3"]]:
        """Draws points spread evenly over the roads' surfaces; returns them and the colours they should have."""
        starts, steps, colour, base, rise = self._pieces
        weight = steps.norm(dim=1)
        piece = torch.multinomial(weight, count, replacement=True, generator=generator)
        along = torch.rand(count, 1, generator=generator)
        aside = (torch.rand(count, 1, generator=generator) - 0.5) * self.width
        step = steps[piece]
        left = torch.stack([-step[:, 1], step[:, 0]], dim=1) / weight[piece, None]
        ground = starts[piece] + along * step + aside * left
        height = base[piece] + along[:, 0] * rise[piece]
        return torch.cat([ground, height[:, None]], dim=1), colour[piece]

    def heights_at(self, points: Float[Tensor, "n 2"]) -> Float[Tensor, " n"]:
        """Height of the road at the place on the centre lines nearest to each point, metres."""
        return self.nearest(points.float())[0]

    def nearest(self, points: Float[Tensor, "n 2"]) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
        """Height of the road at the nearest place on the centre lines, and how far away it is, metres."""
        starts, steps, _, base, rise = self._pieces
        share, away = _nearest_on(starts, steps, points)
        distance, piece = away.min(dim=1)
        return base[piece] + share.gather(1, piece[:, None])[:, 0] * rise[piece], distance

    @cached_property
    def _pieces(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        starts = torch.cat([line[:-1] for line in self.lines])
        steps = torch.cat([line[1:] - line[:-1] for line in self.lines])
        number = torch.cat([torch.full((len(line) - 1,), i) for i, line in enumerate(self.lines)])
        heights = self.heights or tuple(torch.full((len(line),), self.height) for line in self.lines)
        base = torch.cat([height[:-1] for height in heights])
        rise = torch.cat([height[1:] - height[:-1] for height in heights])
        return starts, steps, self.colours[number], base, rise


def read_road_network(entry: Any, origin: Float[Tensor, " 3"], source: str) -> RoadNetwork:
    """Builds the network of a data set's `road_network`; `origin` is what loading subtracted from the poses.

    Raises UserError naming `source` and what is wrong.
    """
    if entry is None:
        raise UserError(f"{source}: has no road_network; draw the roads' centre lines into transforms.json")
    if not isinstance(entry, Mapping):
        raise UserError(f"{source}: road_network must be an object with lines, width and colour")
    unknown = set(entry) - {"lines", "width", "height", "colour"}
    if unknown:
        raise UserError(f"{source}: road_network has the unknown key {sorted(unknown)[0]!r}")
    lines = entry.get("lines")
    if not isinstance(lines, Sequence) or isinstance(lines, str) or len(lines) == 0:
        raise UserError(f"{source}: road_network.lines is empty; give at least one centre line")
    width, height = entry.get("width"), entry.get("height", 0.0)
    if not _is_number(width) or width <= 0:
        raise UserError(f"{source}: road_network.width is {width}; give the roads' width in metres")
    if not _is_number(height):
        raise UserError(f"{source}: road_network.height is {height}; give the roads' height in metres")
    points = [_line(line, number, source) for number, line in enumerate(lines)]
    if any(float(line.abs().max()) > FARTHEST for line in points):
        raise UserError(f"{source}: road_network.lines has a point farther than {FARTHEST:g} m from 0; give metres")
    tensors = tuple(line[:, :2].float() - origin[:2].float() for line in points)
    colours = _colours(entry.get("colour"), len(lines), source)
    heights = _heights(points, "height" in entry, origin, source)
    level = float(torch.cat(heights).median()) if heights else float(height) - float(origin[2])
    network = RoadNetwork(tensors, float(width), level, colours, heights)
    apart = _unconnected(network)
    if apart:
        raise UserError(
            f"{source}: road_network.lines[{apart[0]}] meets no other road of the network; "
            "roads must be connected: extend it, or give it a data set of its own"
        )
    return network


def distance_to_line(line: Float[Tensor, "m 2"], points: Float[Tensor, "n 2"]) -> Float[Tensor, " n"]:
    """Distance of each point to a polyline."""
    return _nearest_on(line[:-1], line[1:] - line[:-1], points)[1].amin(dim=1)


def read_road_file(path: Path) -> Any:
    """Returns the `road_network` entry of a JSON file of its own; raises UserError for a file that is none."""
    try:
        return read_json(path, "give a JSON file with the roads' centre lines")
    except UserError as error:
        raise UserError(f"cannot be read as a road network in JSON: {error}") from error


def network_from_geojson(
    path: Path, width: float, colour: Sequence[int], origin: tuple[float, float] | None = None
) -> tuple[dict, tuple[float, float]]:
    """Returns a `road_network` entry of a GeoJSON file's lines, and the longitude and latitude of its origin.

    Positions become metres east and north of `origin` (longitude, latitude), or of the middle of all points
    (equirectangular: good to a few centimetres over a kilometre). Raises UserError for a file without lines.
    """
    try:
        document = read_json(path, "export the roads' centre lines as GeoJSON")
    except UserError as error:
        raise UserError(f"cannot be read as GeoJSON: {error}") from error
    lines = [line for line in _geojson_lines(document) if len(line) >= 2]
    if not lines:
        raise UserError(f"{path}: holds no LineString; export the roads' centre lines as lines")
    points = [point for line in lines for point in line]
    if not all(len(p) >= 2 and _is_number(p[0]) and abs(p[0]) <= 180 and abs(p[1]) <= 90 for p in points):
        raise UserError(f"{path}: coordinates must be longitude and latitude in degrees (WGS 84)")
    east, north = origin or tuple(sum(p[axis] for p in points) / len(points) for axis in (0, 1))
    metre = math.radians(1.0) * EARTH_RADIUS
    scale = (metre * math.cos(math.radians(north)), metre)
    flat = [[[(p[0] - east) * scale[0], (p[1] - north) * scale[1]] for p in line] for line in lines]
    return {"lines": flat, "width": width, "height": 0.0, "colour": list(colour)}, (east, north)


def _geojson_lines(entry: Any) -> list[list]:
    if not isinstance(entry, dict):
        return []
    if entry.get("type") == "FeatureCollection":
        return [line for feature in entry.get("features", []) for line in _geojson_lines(feature)]
    if entry.get("type") == "Feature":
        return _geojson_lines(entry.get("geometry"))
    if entry.get("type") == "LineString":
        return [entry.get("coordinates", [])]
    if entry.get("type") == "MultiLineString":
        return list(entry.get("coordinates", []))
    return []


def _line(line: Any, number: int, source: str) -> Float[Tensor, "_ axes"]:
    """Points [x, y] or [x, y, z] that differ from the ones before them in x or y, in double precision."""
    good = isinstance(line, Sequence) and not isinstance(line, str) and len(line) >= 2
    good = good and all(isinstance(p, Sequence) and len(p) in (2, 3) and all(map(_is_number, p)) for p in line)
    if not good or len({len(p) for p in line}) > 1:
        raise UserError(
            f"{source}: road_network.lines[{number}] must be two or more points [x, y], or all [x, y, z], in metres"
        )
    points = torch.tensor(line, dtype=torch.float64)
    keep = torch.cat([torch.tensor([True]), (points[1:, :2] - points[:-1, :2]).norm(dim=1) > 1e-9])
    if int(keep.sum()) < 2:
        raise UserError(f"{source}: road_network.lines[{number}] has no length")
    return points[keep]


def _heights(
    points: list[Tensor], height_told: bool, origin: Float[Tensor, " 3"], source: str
) -> tuple[Float[Tensor, " _"], ...] | None:
    if all(line.shape[1] == 2 for line in points):
        return None
    if height_told or any(line.shape[1] == 2 for line in points):
        raise UserError(f"{source}: road_network tells some heights twice or not at all: give all points a z, or none")
    return tuple((line[:, 2] - origin[2]).float() for line in points)


def _nearest_on(
    starts: Float[Tensor, "pieces 2"], steps: Float[Tensor, "pieces 2"], points: Float[Tensor, "n 2"]
) -> tuple[Float[Tensor, "n pieces"], Float[Tensor, "n pieces"]]:
    """Where on each piece the place nearest to each point lies (0 to 1), and how far away it is (m)."""
    (x, y), (along_x, along_y) = points.unbind(dim=1), steps.unbind(dim=1)
    # plane by plane: sums over an axis of two numbers are slow
    offset_x, offset_y = x[:, None] - starts[:, 0], y[:, None] - starts[:, 1]
    share = ((offset_x * along_x + offset_y * along_y) / steps.square().sum(dim=1)).clamp(0, 1)
    return share, torch.hypot(offset_x - share * along_x, offset_y - share * along_y)


def _colours(colour: Any, count: int, source: str) -> Float[Tensor, "lines 3"]:
    rows = colour if isinstance(colour, Sequence) and colour and isinstance(colour[0], Sequence) else [colour] * count
    good = len(rows) == count and all(
        isinstance(row, Sequence) and len(row) == 3 and all(_is_number(c) and 0 <= c <= 255 for c in row)
        for row in rows
    )
    if not good:
        raise UserError(
            f"{source}: road_network.colour must be [r, g, b] of 0 to 255, or one such triple per line ({count})"
        )
    return torch.tensor(rows, dtype=torch.float32) / 255


def _unconnected(network: RoadNetwork) -> list[int]:
    """Numbers of the lines that cannot be reached from the first one over touching roads."""
    reached, open_ = {0}, [0]
    while open_:
        line = network.lines[open_.pop()]
        for other in set(range(len(network.lines))) - reached:
            points = network.lines[other]
            gap = min(distance_to_line(line, points).min(), distance_to_line(points, line).min())
            if float(gap) <= network.width:
                reached.add(other)
                open_.append(other)
    return sorted(set(range(len(network.lines))) - reached)


def _lengths(line: Tensor) -> Tensor:
    return (line[1:] - line[:-1]).norm(dim=1)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
