"""Static street furniture: slabs, painted marks, buildings with windows, trees, hedges (world frame, metres)."""

import numpy as np

from worlds.meshes import Material, Mesh, blob, block, cylinder, merge, quad
from worlds.vehicles import GLASS

ASPHALT = Material((0.115, 0.115, 0.122), grain=0.16)
PAVEMENT = Material((0.36, 0.35, 0.33), grain=0.08)
GRASS = Material((0.10, 0.20, 0.05), grain=0.22)
PAINT = Material((0.72, 0.72, 0.70), grain=0.05)
FOLIAGE = Material((0.06, 0.15, 0.035), grain=0.3)
TRUNK = Material((0.12, 0.075, 0.045))
ROOF = Material((0.22, 0.21, 0.21), grain=0.1)
FRAME = Material((0.62, 0.61, 0.58))
DOOR = Material((0.14, 0.07, 0.04))

Rectangle = tuple[float, float, float, float]
"""x0, y0, x1, y1 in metres."""


def ground(area: Rectangle) -> Mesh:
    """The asphalt plane z = 0, a thin slab so that it casts no light from below."""
    x0, y0, x1, y1 = area
    return block((x0, y0, -0.2), (x1, y1, 0.0), ASPHALT)


def slab(area: Rectangle, top: float, material: Material) -> Mesh:
    """A raised surface (pavement, lawn) from the asphalt up to `top` metres."""
    x0, y0, x1, y1 = area
    return block((x0, y0, -0.1), (x1, y1, top), material)


def mark(area: Rectangle, height: float = 0.008, material: Material = PAINT) -> Mesh:
    """A painted rectangle on the road."""
    x0, y0, x1, y1 = area
    return quad([(x0, y0, height), (x1, y0, height), (x1, y1, height), (x0, y1, height)], material)


def dashes(start: float, end: float, across: float, axis: str, length: float = 2.0, gap: float = 2.0) -> list[Mesh]:
    """A dashed line 0.14 m wide along `axis` ("x" or "y") at the coordinate `across`."""
    parts = []
    for low in np.arange(start, end - length + 1e-9, length + gap):
        span, side = (float(low), float(low) + length), (across - 0.07, across + 0.07)
        area = (span[0], side[0], span[1], side[1]) if axis == "x" else (side[0], span[0], side[1], span[1])
        parts.append(mark(area))
    return parts


def zebra(area: Rectangle, axis: str, stripe: float = 0.45) -> list[Mesh]:
    """A pedestrian crossing: stripes laid one after another along `axis`."""
    x0, y0, x1, y1 = area
    low, high = (x0, x1) if axis == "x" else (y0, y1)
    starts = np.arange(low + 0.2, high - stripe, 2 * stripe)
    if axis == "x":
        return [mark((float(s), y0, float(s) + stripe, y1)) for s in starts]
    return [mark((x0, float(s), x1, float(s) + stripe)) for s in starts]


def _wall_panels(width: float, height: float, storey: float) -> list[tuple[float, float, float, float, str]]:
    """Panels of one facade as (left, right, bottom, top, kind) in the wall's own coordinates."""
    columns = max(1, int((width - 0.8) // 2.4))
    pitch = (width - 0.8) / columns
    panels = []
    for floor in range(max(1, int(height // storey))):
        base = floor * storey
        for column in range(columns):
            centre = 0.4 + (column + 0.5) * pitch
            if floor == 0 and column == columns // 2:
                panels.append((centre - 0.55, centre + 0.55, 0.1, 2.2, "door"))
            else:
                panels.append((centre - 0.6, centre + 0.6, base + 0.95, base + 2.3, "window"))
    return panels


def _facade(origin: np.ndarray, along: np.ndarray, normal: np.ndarray, width: float, height: float, storey: float):
    up = np.array([0.0, 0.0, 1.0])
    parts = []

    def panel(left, right, bottom, top, depth, material):
        base = origin + depth * normal
        corners = [(left, bottom), (right, bottom), (right, top), (left, top)]
        parts.append(quad([base + u * along + v * up for u, v in corners], material))

    for left, right, bottom, top, kind in _wall_panels(width, height, storey):
        panel(left - 0.1, right + 0.1, bottom - (0.1 if kind == "window" else 0.0), top + 0.1, 0.02, FRAME)
        panel(left, right, bottom, top, 0.04, GLASS if kind == "window" else DOOR)
    return parts


def building(area: Rectangle, height: float, colour: tuple[float, float, float], storey: float = 3.0) -> Mesh:
    """A block with rows of windows and a door on every side, a plinth, a cornice and a flat roof."""
    x0, y0, x1, y1 = area
    wall = Material(colour, grain=0.06)
    plinth = Material(tuple(0.6 * channel for channel in colour))
    parts = [
        block((x0, y0, 0.0), (x1, y1, height), wall),
        block((x0 - 0.06, y0 - 0.06, 0.0), (x1 + 0.06, y1 + 0.06, 0.45), plinth),
        block((x0 - 0.2, y0 - 0.2, height - 0.3), (x1 + 0.2, y1 + 0.2, height), FRAME),
        block((x0 + 0.1, y0 + 0.1, height), (x1 - 0.1, y1 - 0.1, height + 0.05), ROOF),
    ]
    ex, ey = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    for origin, along, normal, width in (
        ((x0, y0, 0.0), ex, -ey, x1 - x0),
        ((x1, y0, 0.0), ey, ex, y1 - y0),
        ((x1, y1, 0.0), -ex, ey, x1 - x0),
        ((x0, y1, 0.0), -ey, -ex, y1 - y0),
    ):
        parts += _facade(np.array(origin), along, normal, width, height, storey)
    return merge(parts)


def tree(x: float, y: float, height: float, rng: np.random.Generator) -> Mesh:
    """A trunk under three lumps of foliage; `height` is approximate."""
    crown = 0.32 * height
    parts = [cylinder((x, y, 0.25 * height), 0.16, 0.5 * height, TRUNK, sides=8)]
    for _ in range(3):
        shift = rng.uniform(-0.35, 0.35, 3) * crown
        parts.append(
            blob((x + shift[0], y + shift[1], height - crown + 0.5 * shift[2]), (0.85 * crown,) * 3, FOLIAGE, rng)
        )
    return merge(parts)


def hedge(area: Rectangle, height: float) -> Mesh:
    """A clipped hedge."""
    x0, y0, x1, y1 = area
    return block((x0, y0, 0.0), (x1, y1, height), FOLIAGE)
