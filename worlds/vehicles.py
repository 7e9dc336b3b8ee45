"""Vehicle bodies in their own frame: x forward, y left, centred in x and y, wheels standing on z = 0.

Each body fills its (length, width, height) box exactly, so the box is ground truth for the mesh. No two panels share a
plane: lamps, rims and stripes stand a centimetre or more off what they lie on, or hits would flicker between the two.
"""

from worlds.meshes import Material, Mesh, block, cylinder, merge, quad, tapered

GLASS = Material((0.03, 0.04, 0.05), gloss=0.35)
TYRE = Material((0.02, 0.02, 0.02))
RIM = Material((0.35, 0.35, 0.36))
DARK = Material((0.03, 0.03, 0.035))
HEAD_LAMP = Material((0.85, 0.85, 0.75), gloss=0.1)
TAIL_LAMP = Material((0.55, 0.02, 0.02))
SKIN = 0.03
"""How far painted panels stay inside the box, metres."""

Size = tuple[float, float, float]
Colour = tuple[float, float, float]


def _wheels(positions: tuple[float, ...], half_width: float, radius: float) -> list[Mesh]:
    """Tyres with rims that reach the box's sides."""
    parts = []
    for x in positions:
        for side in (-1, 1):
            y = side * (half_width - 0.115)
            parts.append(cylinder((x, y, radius), radius, 0.21, TYRE, axis="y"))
            parts.append(cylinder((x, y, radius), 0.55 * radius, 0.23, RIM, axis="y"))
    return parts


def _lamps(front: float, rear: float, half_width: float, z: tuple[float, float], width: float) -> list[Mesh]:
    """Head and tail lamps whose faces lie at `front` and `rear`."""
    parts = []
    for side in (-1, 1):
        inner, outer = sorted((side * (half_width - 0.08 - width), side * (half_width - 0.08)))
        parts.append(block((front - 0.1, inner, z[0]), (front, outer, z[1]), HEAD_LAMP))
        parts.append(block((rear, inner, z[0]), (rear + 0.1, outer, z[1]), TAIL_LAMP))
    return parts


def _side_panels(corners: list[tuple[float, float]], y: tuple[float, float], material: Material) -> list[Mesh]:
    """The same (x, z) quadrilateral on both sides, at |y| = y[0] along its first edge, y[1] along the opposite."""
    depths = (y[0], y[0], y[1], y[1])
    right = [(x, -depth, z) for (x, z), depth in zip(corners, depths)]
    left = [(x, depth, z) for (x, z), depth in zip(corners, depths)]
    return [quad(right, material), quad(left[::-1], material)]


def sedan(size: Size, colour: Colour) -> Mesh:
    """A three-box car of `size` (length, width, height) metres."""
    length, width, height = size
    paint = Material(colour, gloss=0.06)
    front, rear, half = length / 2, -length / 2, width / 2
    waist, sill, belt = 0.60 * height, 0.16 * height, 0.4 * height
    side, shoulder = half - SKIN, half - SKIN - 0.03
    glazed, roof = (waist, 0.95 * height), (0.93 * height, height)
    parts = [
        tapered((rear + 0.08, front - 0.07), (rear + 0.04, front - 0.05), (side - 0.04, side), (sill, belt), paint),
        tapered((rear + 0.04, front - 0.05), (rear + 0.06, front - 0.22), (side, shoulder), (belt, waist), paint),
        tapered((rear + 0.55, front - 1.25), (rear + 1.05, front - 1.95), (side - 0.05, 0.68 * half), glazed, GLASS),
        tapered((rear + 0.98, front - 1.85), (rear + 1.1, front - 2.0), (0.71 * half, 0.66 * half), roof, paint),
        block((rear + 0.01, -half + 0.1, sill + 0.02), (rear + 0.2, half - 0.1, 0.36 * height), DARK),
        block((front - 0.2, -half + 0.1, sill + 0.02), (front - 0.01, half - 0.1, 0.36 * height), DARK),
    ]  # fmt: skip
    pillar = (-0.37, -0.23)
    parts.append(tapered(pillar, pillar, (shoulder - 0.005, 0.7 * half), (waist, 0.95 * height), paint))
    parts += _lamps(front, rear, half, (0.42 * height, 0.53 * height), 0.32)
    parts += _wheels((rear + 0.8, front - 0.85), half, 0.225 * height)
    return merge(parts)


def van(size: Size, colour: Colour) -> Mesh:
    """A delivery van of `size` (length, width, height) metres: one tall body, a sloped windscreen, a stripe."""
    length, width, height = size
    paint = Material(colour, gloss=0.03)
    stripe = Material((0.05, 0.16, 0.22))
    front, rear, side = length / 2, -length / 2 + SKIN, width / 2 - SKIN
    nose, hood = front - SKIN, 0.46 * height
    parts = [
        tapered((rear, nose), (rear, nose - 0.02), (side, side), (0.3, hood), paint),
        tapered((rear, nose - 0.75), (rear + 0.05, nose - 1.55), (side, side - 0.08), (hood, height), paint),
        tapered((nose - 0.8, nose - 0.02), (nose - 0.8, nose - 0.75), (side, side - 0.02), (hood, hood + 0.12), paint),
        block((rear + 0.1, -side + 0.05, 0.2), (nose - 0.1, side - 0.05, 0.32), DARK),
        block((nose - 0.3, -side + 0.1, 0.28), (front - 0.01, side - 0.1, 0.5), DARK),
    ]
    rise, run = height - hood, 0.80

    def screen(y: float, share: float) -> tuple[float, float, float]:
        return (nose - 0.75 - run * share + 0.02, y, hood + rise * share)

    low, high = side - 0.12, side - 0.2
    parts.append(quad([screen(-low, 0.12), screen(low, 0.12), screen(high, 0.82), screen(-high, 0.82)], GLASS))
    window = [
        (nose - 1.9, hood + 0.1),
        (nose - 1.0, hood + 0.1),
        (nose - 1.45, height - 0.35),
        (nose - 1.9, height - 0.35),
    ]
    parts += _side_panels(window, (side + 0.012, side - 0.05), GLASS)
    band = [(rear + 0.15, 0.72), (nose - 0.2, 0.72), (nose - 0.2, 0.98), (rear + 0.15, 0.98)]
    parts += _side_panels(band, (side + 0.012, side + 0.012), stripe)
    parts += _lamps(front, -length / 2, width / 2, (0.62, 0.85), 0.22)
    parts += _wheels((rear + 0.95, nose - 0.9), width / 2, 0.34)
    return merge(parts)


def box_truck(size: Size, colour: Colour) -> Mesh:
    """A box truck of `size` (length, width, height) metres: a cargo box, a darker cab, a pale stripe."""
    length, width, height = size
    cargo = Material(colour, gloss=0.02)
    cab = Material(tuple(0.55 * channel for channel in colour), gloss=0.05)
    stripe = Material((0.75, 0.70, 0.62))
    front, rear, half = length / 2, -length / 2, width / 2
    split, nose, flank = front - 0.27 * length, front - SKIN, half - SKIN
    cab_side, cab_top = half - 0.1, 0.82 * height
    mid = 0.52 * cab_top + 0.1
    parts = [
        block((rear + SKIN, -flank, 0.75), (split - 0.1, flank, height), cargo),
        tapered((split, nose), (split, nose), (cab_side, cab_side), (0.4, mid), cab),
        tapered((split, nose), (split, nose - 0.35), (cab_side, cab_side - 0.1), (mid, cab_top), cab),
        block((rear + 0.1, -half + 0.25, 0.5), (split + 0.2, half - 0.25, 0.78), DARK),
        block((front - 0.2, -cab_side + 0.02, 0.35), (front - 0.01, cab_side - 0.02, 0.65), DARK),
    ]
    band = [(rear + 0.25, 1.45), (split - 0.3, 1.45), (split - 0.3, 1.85), (rear + 0.25, 1.85)]
    parts += _side_panels(band, (half - 0.01, half - 0.01), stripe)

    def pane(y: float, share: float) -> tuple[float, float, float]:
        return (nose - 0.35 * share + 0.015, y, mid + (cab_top - mid) * share)

    low, high = cab_side - 0.1, cab_side - 0.18
    parts.append(quad([pane(-low, 0.08), pane(low, 0.08), pane(high, 0.88), pane(-high, 0.88)], GLASS))
    door = [
        (split + 0.25, mid + 0.05),
        (nose - 0.2, mid + 0.05),
        (nose - 0.45, cab_top - 0.15),
        (split + 0.25, cab_top - 0.15),
    ]
    parts += _side_panels(door, (cab_side + 0.01, cab_side - 0.07), GLASS)
    parts += _lamps(front, rear, cab_side, (0.72, 0.92), 0.25)
    parts += _wheels((rear + 1.1, front - 0.75), half, 0.43)
    return merge(parts)
