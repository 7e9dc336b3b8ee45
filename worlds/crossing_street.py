"""The streets of both intersection scenarios: a one-way street along +x crosses a two-way road along y at the origin.

The ego drives along y = EGO_LANE; cars park on the left of its lane, a van among them; behind them a corner building.
Together they hide the crossing road from far back and release it over the last metres before the stop line.
"""

import numpy as np

from worlds.meshes import Mesh, merge
from worlds.street import GRASS, PAVEMENT, building, dashes, ground, hedge, mark, slab, tree, zebra
from worlds.vehicles import sedan, van

AREA = (-38.0, -24.0, 24.0, 30.0)
EGO_LANE = -1.6
TRUCK_LANE = -1.6
STREET = (-3.2, 2.6)
"""y of the ego street's kerbs: one lane and a parking strip."""
ROAD = (-3.2, 3.2)
"""x of the crossing road's kerbs."""
STOP_LINE = -7.6
SCENE_BOX = np.array([[-38.0, -24.0, -0.3], [24.0, 30.0, 7.2]])

WALLS = ((0.48, 0.24, 0.17), (0.60, 0.52, 0.38), (0.38, 0.40, 0.44), (0.55, 0.36, 0.26), (0.62, 0.60, 0.54))


def _surfaces() -> Mesh:
    x0, y0, x1, y1 = AREA
    south, north = STREET
    west, east = ROAD
    parts = [ground(AREA)]
    for area in ((x0, north, west, y1), (east, north, x1, y1), (x0, y0, west, south), (east, y0, x1, south)):
        parts.append(slab(area, 0.12, PAVEMENT))
    lawns = [(x0, 4.6, -27.0, y1), (-27.0, 17.0, -5.4, y1), (5.4, 20.0, x1, y1), (20.5, 4.6, x1, 20.0)]
    lawns += [(x0, y0, -24.0, -5.2), (-24.0, y0, -5.4, -17.0), (5.4, y0, x1, -18.0), (20.5, -18.0, x1, -5.2)]
    parts += [slab(area, 0.16, GRASS) for area in lawns]
    return merge(parts)


def _marks() -> Mesh:
    x0, y0, x1, y1 = AREA
    south, north = STREET
    west, east = ROAD
    parts = [mark((STOP_LINE, south + 0.1, STOP_LINE + 0.4, 0.0))]
    parts += zebra((west - 3.4, south + 0.1, west - 0.9, north - 0.1), "y")
    parts += zebra((west + 0.1, north + 0.9, east - 0.1, north + 3.4), "x")
    parts += dashes(north + 4.2, y1, 0.0, "y") + dashes(y0, south - 0.8, 0.0, "y")
    parts += dashes(x0, STOP_LINE - 0.5, 0.12, "x", length=1.0, gap=1.0) + dashes(east + 1.0, x1, 0.12, "x", 1.0, 1.0)
    return merge(parts)


def _buildings(rng: np.random.Generator, jitter: float) -> list[tuple[str, Mesh]]:
    walls = [WALLS[i] for i in rng.permutation(len(WALLS))]
    # The corner that faces the ego's approach keeps its sight line: only its far sides and its height vary.
    plots = {
        "building_nw": (-25.5, 4.4, -10.6, 14.0, 3.7),
        "building_ne": (7.6, 5.2, 19.0, 18.0, 6.2),
        "building_sw": (-21.5, -16.0, -8.0, -7.0, 3.9),
        "building_se": (7.8, -16.5, 19.0, -6.2, 6.2),
    }
    out = []
    for colour, (name, (x0, y0, x1, y1, height)) in zip(walls, plots.items()):
        far = rng.uniform(-0.6, 0.6, 2) * jitter
        area = (x0 + far[0], y0, x1, y1 + far[1]) if name == "building_nw" else (x0, y0 + far[0], x1 + far[1], y1)
        out.append((name, building(area, height + 0.3 * jitter * float(rng.uniform(-1, 1)), colour)))
    return out


def _plants(rng: np.random.Generator, jitter: float) -> list[tuple[str, Mesh]]:
    x0, y0, x1, y1 = AREA
    spots = [(-31, 8.5), (-34.5, 15), (-29.5, 19), (-20, 22), (-11.5, 20.5), (10, 24), (17, 23), (20.9, 11)]
    spots += [(-28, -8.5), (-34, -11), (-29, -17.5), (-12, -20), (-20, -20.5), (12, -20.5), (20.9, -9.5)]
    trees = []
    for x, y in spots:
        dx, dy = rng.uniform(-0.8, 0.8, 2) * jitter
        trees.append(tree(x + dx, y + dy, 5.0 + 0.9 * jitter * rng.uniform(-1, 1), rng))
    (south, north), (west, east) = STREET, ROAD
    rows = [
        (x0, y0, west - 2, y0 + 0.9),
        (east + 2, y0, x1, y0 + 0.9),
        (x0, y1 - 0.9, west - 2, y1),
        (east + 2, y1 - 0.9, x1, y1),
    ]
    rows += [
        (x0, y0, x0 + 0.9, south - 2),
        (x0, north + 2, x0 + 0.9, y1),
        (x1 - 0.9, y0, x1, south - 2),
        (x1 - 0.9, north + 2, x1, y1),
    ]
    return [("trees", merge(trees)), ("hedges", merge([hedge(row, 1.7) for row in rows]))]


def _parked(rng: np.random.Generator) -> list[tuple[str, Mesh]]:
    white, silver, green = (0.55, 0.55, 0.53), (0.38, 0.39, 0.40), (0.10, 0.17, 0.12)
    lane = STREET[1] - 1.12
    out = [("parked_van", van((5.2, 2.0, 2.45), white).placed(-17.25, lane, 0.0, 0.0))]
    for number, (x, paint) in enumerate(((-24.3, silver), (-30.2, green))):
        shift = rng.uniform(-0.3, 0.3)
        out.append((f"parked_car_{number}", sedan((4.3, 1.75, 1.45), paint).placed(x + shift, lane + 0.08, 0.0, 0.0)))
    return out


def street_bodies(rng: np.random.Generator, jitter: float, parked: bool) -> list[tuple[str, Mesh]]:
    """The static bodies by name; `jitter` (0..1) scales how far the seed moves what may vary."""
    return [
        ("ground", _surfaces()),
        ("marks", _marks()),
        *_buildings(rng, jitter),
        *_plants(rng, jitter),
        *(_parked(rng) if parked else []),
    ]
