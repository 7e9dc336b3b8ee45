"""The streets of the two-lane merge: a main road along x, and a ramp from the south that joins its near lane.

A wall along the main road and a lorry parked behind it hide the traffic that comes from the left (from -x).
"""

import math

import numpy as np

from worlds.meshes import Material, Mesh, block, hexahedron, merge, quad
from worlds.routes import Route, curve
from worlds.street import GRASS, PAINT, PAVEMENT, building, dashes, ground, hedge, mark, slab, tree
from worlds.vehicles import box_truck

AREA = (-38.0, -30.0, 28.0, 16.0)
SCENE_BOX = np.array([[-38.0, -30.0, -0.3], [28.0, 16.0, 7.2]])
HEADING = math.radians(65.0)
"""Heading of the ramp, counter-clockwise from the main road."""
BEND = (-1.4, -4.6)
"""Where the ramp's straight part ends and its curve into the main lane begins."""
JOINED = (8.0, 0.0)
RAMP_LENGTH = 26.0
"""Length of the ramp's straight part, metres."""
RAMP_HALF = 1.9
MAIN = (-1.9, 5.6)
"""y of the main road's edges: the near lane around y = 0, the far lane beyond y = 1.85."""
WALL_END = -13.0
"""x where the wall ends and the main road comes into view."""
BRICK = Material((0.36, 0.20, 0.15), grain=0.08)


def ramp_point(distance: float, left: float = 0.0) -> tuple[float, float]:
    """The point `distance` metres before the bend and `left` metres left of the ramp's middle."""
    cos, sin = math.cos(HEADING), math.sin(HEADING)
    return (BEND[0] - distance * cos - left * sin, BEND[1] - distance * sin + left * cos)


def ego_route() -> Route:
    """Up the ramp, around the bend, along the near lane."""
    corner = (BEND[0] - BEND[1] / math.tan(HEADING), 0.0)
    return Route((ramp_point(RAMP_LENGTH), *curve(BEND, corner, JOINED), (AREA[2], 0.0)))


def _edge(y: float, left: float) -> tuple[float, float]:
    """The point at height `y` on the line `left` metres left of the ramp's middle."""
    x, y0 = ramp_point(0.0, left)
    return (x + (y - y0) / math.tan(HEADING), y)


def _plate(corners: list[tuple[float, float]], top: float, material: Material) -> Mesh:
    """A raised surface over four corners, counter-clockwise."""
    return hexahedron([(x, y, -0.1) for x, y in corners], [(x, y, top) for x, y in corners], material)


def _surfaces() -> Mesh:
    x0, y0, x1, y1 = AREA
    south, north = MAIN
    west = [(x0, y0), _edge(y0, RAMP_HALF), _edge(south, RAMP_HALF + 0.3), (x0, south)]
    east_low = [_edge(y0, -RAMP_HALF), (x1, y0), (x1, -5.2), _edge(-5.2, -RAMP_HALF)]
    east_high = [_edge(-5.2, -RAMP_HALF), (x1, -5.2), (x1, south), (4.8, south)]
    parts = [
        ground(AREA),
        slab((x0, north, x1, north + 2.4), 0.12, PAVEMENT),
        slab((x0, north + 2.4, x1, y1), 0.14, GRASS),
    ]
    return merge(parts + [_plate(corners, 0.10, GRASS) for corners in (west, east_low, east_high)])


def _ramp_mark(far: float, near: float, right: float, left: float) -> Mesh:
    """A painted bar on the ramp between two distances before the bend."""
    corners = [ramp_point(far, left), ramp_point(far, right), ramp_point(near, right), ramp_point(near, left)]
    return quad([(x, y, 0.008) for x, y in corners], PAINT)


def _marks() -> Mesh:
    x0, _, x1, _ = AREA
    parts = dashes(x0, x1, 1.85, "x", length=3.0, gap=3.0)
    parts += [mark((x0, MAIN[1] - 0.3, x1, MAIN[1] - 0.16)), mark((x0, MAIN[0] + 0.16, -4.5, MAIN[0] + 0.3))]
    parts += [_ramp_mark(0.4, 0.0, -1.6 + 0.8 * k, -1.2 + 0.8 * k) for k in range(4)]
    parts += [_ramp_mark(RAMP_LENGTH, 0.8, side * 1.65 - 0.06, side * 1.65 + 0.06) for side in (-1, 1)]
    return merge(parts)


def street_bodies(rng: np.random.Generator, jitter: float) -> list[tuple[str, Mesh]]:
    """The static bodies by name; `jitter` (0..1) scales how far the seed moves what may vary."""
    x0, y0, x1, _ = AREA

    def vary(amount: float) -> float:
        return amount * jitter * float(rng.uniform(-1.0, 1.0))

    out = [("ground", _surfaces()), ("marks", _marks())]
    colours = [(0.48, 0.24, 0.17), (0.60, 0.52, 0.38), (0.38, 0.40, 0.44)]
    plots = [(-30.0, 9.4, -14.0, 15.5), (-9.0, 9.4, 6.0, 15.5), (10.5, 9.4, 24.0, 15.5)]
    for number, (plot, which) in enumerate(zip(plots, rng.permutation(3))):
        area = (plot[0] + vary(0.5), plot[1], plot[2] + vary(0.5), plot[3])
        out.append((f"building_{number}", building(area, 5.9 + vary(0.4), colours[which])))
    out.append(("building_se", building((9.0, -19.0, 20.0 + vary(0.8), -9.0), 3.8 + vary(0.2), (0.62, 0.60, 0.54))))
    out.append(("wall", block((x0 + 1.0, -3.15, 0.0), (WALL_END, -2.9, 2.2), BRICK)))
    lorry = box_truck((7.0, 2.4, 3.0), (0.32, 0.36, 0.34))
    out.append(("parked_lorry", lorry.placed(WALL_END - 5.0 + vary(0.3), -6.2, 0.10, 0.0)))
    spots = [
        (-33, -9),
        (-27, -14),
        (-20, -20),
        (-31, -24),
        (-24, -26),
        (-17, -26),
        (4, -24),
        (24, -22),
        (24, -8),
        (16, -25),
    ]
    trees = [tree(x + vary(0.6), y + vary(0.6), 4.8 + vary(0.8), rng) for x, y in spots]
    out.append(("trees", merge(trees)))
    low = y0 + 0.9
    rows = [
        (x0, y0, _edge(y0, 4.0)[0], low),
        (_edge(y0, -4.0)[0], y0, x1, low),
        (x0, y0, x0 + 0.9, -3.5),
        (x1 - 0.9, y0, x1, -3.5),
    ]
    return [*out, ("hedges", merge([hedge(row, 1.6) for row in rows]))]
