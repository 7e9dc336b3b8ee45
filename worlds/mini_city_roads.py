"""The mini-city's roads: a loop with rounded corners and a cross street, two lanes each (metres at 1/10 scale, z = 0).

Traffic keeps to the right. The three trajectories are closed lines along lane middles, in driving order.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from worlds.meshes import Material, Mesh, merge, painted
from worlds.polylines import Line, arc_lengths, beside, distance_to, resampled, rounded
from worlds.shading import SKY, SUN, Light, to_uint8
from worlds.street import ASPHALT, PAINT, PAVEMENT

AREA = (0.0, 0.0, 6.0, 5.0)
LANE = 0.35
WIDTH = 2 * LANE
X0, Y0, X1, Y1 = 0.75, 0.75, 5.25, 4.25
CROSS = 3.0
CORNER = 1.0
KERB = 0.55
"""Radius of the kerbs where the cross street meets the loop."""
PIECE = 0.05

LOOP: Line = rounded([(X0, Y0), (X1, Y0), (X1, Y1), (X0, Y1)], [CORNER] * 4)
STREET: Line = np.array([(CROSS, Y0), (CROSS, Y1)])
CENTRE_LINES = (LOOP, STREET)


def trajectories() -> dict[str, Line]:
    """The three trajectories to be driven (compare Fig. 3 of the paper)."""
    half, turn = LANE / 2, 0.85
    out = CORNER + half
    x0, y0, x1, y1 = X0 - half, Y0 - half, X1 + half, Y1 + half
    up = CROSS + half
    left = [(x0, y0), (up, y0), (up, y1), (x0, y1)]
    right = [(up, Y0 + half), (up, Y1 - half), (X1 - half, Y1 - half), (X1 - half, Y0 + half)]
    return {
        "outer_loop": rounded([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], [out] * 4),
        "left_turns": rounded(left, [out, turn, turn, out]),
        "right_turns": rounded(right, [0.8, 0.8, CORNER - half, CORNER - half]),
    }


def on_road(points: Float[np.ndarray, "m 2"], margin: float = 0.0) -> Bool[np.ndarray, " _"]:
    """Which points lie on asphalt or within `margin` of it; the rounded kerbs of the junctions count."""
    near = np.min([distance_to(line, points) for line in CENTRE_LINES], axis=0) <= LANE + margin
    across, up = np.abs(points[:, 0] - CROSS), np.minimum(points[:, 1] - Y0, Y1 - points[:, 1])
    mouth = (across <= LANE + KERB) & (np.abs(up) <= LANE + KERB) & (up > 0)
    centre = np.hypot(across - LANE - KERB, up - LANE - KERB)
    return near | (mouth & (centre >= KERB - margin))


def road_bodies() -> list[tuple[str, Mesh]]:
    """Asphalt, pavement and markings."""
    asphalt = [band(resampled(line, PIECE), -LANE, LANE, 0.0, ASPHALT) for line in CENTRE_LINES]
    asphalt += [_kerb_fill(side, up) for side in (-1, 1) for up in (-1, 1)]
    pavement = [
        pieces(line, side * (LANE + 0.05), 0.09, 0.004, PAVEMENT, lambda points: on_road(points, 0.02))
        for line in CENTRE_LINES
        for side in (-1, 1)
    ]
    return [("road", merge(asphalt)), ("pavement", merge(pavement)), ("markings", merge(_marks()))]


def band(line: Line, right: float, left: float, height: float, material: Material) -> Mesh:
    """A flat strip along a line from `right` to `left` of it (metres to the left), facing up."""
    edges = np.stack([beside(line, right), beside(line, left)], axis=1).reshape(-1, 2)
    vertices = np.concatenate([edges, np.full((len(edges), 1), height)], axis=1)
    first = 2 * np.arange(len(line) - 1)
    faces = np.concatenate([np.stack([first, first + 2, first + 1], 1), np.stack([first + 1, first + 2, first + 3], 1)])
    return painted(vertices, faces, material)


def pieces(
    line: Line, left: float, width: float, height: float, material: Material,
    skip: Callable[[Line], Bool[np.ndarray, " _"]], dash: float = 0.0,
) -> Mesh:  # fmt: skip
    """A band `left` of a line in short pieces, without those whose middle is skipped and every other dash."""
    fine = resampled(beside(resampled(line, PIECE), left), PIECE)
    middle = (fine[:-1] + fine[1:]) / 2
    keep = ~skip(middle)
    if dash:
        keep &= (arc_lengths(fine)[:-1] // dash) % 2 == 0
    parts = [band(fine[i : i + 2], -width / 2, width / 2, height, material) for i in np.flatnonzero(keep)]
    return merge(parts)


def _kerb_fill(side: int, up: int) -> Mesh:
    """The asphalt between a kerb's arc and the corner of the two roads."""
    base = Y0 if up > 0 else Y1
    corner = np.array([CROSS + side * LANE, base + up * LANE])
    centre = corner + KERB * np.array([side, up])
    angle = np.linspace(0.0, np.pi / 2, 13)
    arc = centre - KERB * np.stack([side * np.cos(angle), up * np.sin(angle)], axis=1)
    points = np.concatenate([[corner], arc])
    fan = np.array([(0, i, i + 1) for i in range(1, len(arc))])
    if side * up > 0:
        fan = fan[:, ::-1]
    return painted(np.concatenate([points, np.zeros((len(points), 1))], axis=1), fan, ASPHALT)


def _marks() -> list[Mesh]:
    height, thin, edge = 0.001, 0.018, LANE - 0.02

    def in_street(points: Line) -> Bool[np.ndarray, " _"]:
        return np.abs(points[:, 0] - CROSS) < LANE + KERB

    def inside(points: Line) -> Bool[np.ndarray, " _"]:
        return in_street(points) & (points[:, 1] > Y0) & (points[:, 1] < Y1)

    def mouth(points: Line) -> Bool[np.ndarray, " _"]:
        return np.abs(points[:, 0] - CROSS) < LANE

    def nothing(points: Line) -> Bool[np.ndarray, " _"]:
        return np.zeros(len(points), bool)

    reach = LANE + KERB
    street = np.array([(CROSS, Y0 + reach), (CROSS, Y1 - reach)])
    marks = [pieces(LOOP, side * edge, thin, height, PAINT, inside) for side in (-1, 1)]
    marks += [pieces(street, side * edge, thin, height, PAINT, nothing) for side in (-1, 1)]
    marks.append(pieces(LOOP, 0.0, thin, height, PAINT, mouth, dash=0.15))
    marks.append(pieces(street, 0.0, thin, height, PAINT, nothing, dash=0.15))
    # a stop line across each lane that leads to the loop
    for y, low, high in ((Y1 - reach, 0.0, edge), (Y0 + reach, -edge, 0.0)):
        marks.append(band(np.array([(CROSS + low, y), (CROSS + high, y)]), -0.02, 0.02, height, PAINT))
    return marks


def road_network() -> dict[str, Any]:
    """The roads as a data set tells them: centre lines, width, height, and the colour of asphalt in the sun."""
    colour = np.array(ASPHALT.colour, np.float32) * (SUN * Light().direction[2] + SKY)
    return {
        "lines": [resampled(line, 0.25).round(4).tolist() for line in CENTRE_LINES],
        "width": WIDTH,
        "height": 0.0,
        "colour": to_uint8(colour).tolist(),
    }
