"""Polylines on the ground: rounded corners, parallel lines, and even pieces (metres; [n, 2] arrays)."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

Line = Float[np.ndarray, "_ 2"]
SMALLEST_STEP = 0.02
"""Length of the pieces of a rounded corner, metres."""


def rounded(corners: Sequence[tuple[float, float]], radii: Sequence[float]) -> Line:
    """A closed line through `corners` whose corner i is an arc of `radii[i]`; the first point comes again at the end.

    The arcs must fit beside each other: a radius reaches radius * tan(turn / 2) along both sides of its corner.
    """
    points = [np.array(corner, float) for corner in corners]
    line: list[np.ndarray] = []
    for i, (corner, radius) in enumerate(zip(points, radii)):
        before, after = points[i - 1] - corner, points[(i + 1) % len(points)] - corner
        before, after = before / np.linalg.norm(before), after / np.linalg.norm(after)
        half = 0.5 * math.acos(float(np.clip(before @ after, -1, 1)))
        middle = (before + after) / np.linalg.norm(before + after)
        centre = corner + middle * radius / math.sin(half)
        start = corner + before * radius / math.tan(half) - centre
        turn = math.pi - 2 * half
        sign = 1.0 if before[1] * after[0] - before[0] * after[1] > 0 else -1.0
        pieces = max(int(turn * radius / SMALLEST_STEP), 2)
        for angle in np.linspace(0.0, sign * turn, pieces + 1):
            cos, sin = math.cos(angle), math.sin(angle)
            line.append(centre + np.array([cos * start[0] - sin * start[1], sin * start[0] + cos * start[1]]))
    return np.array([*line, line[0]])


def resampled(line: Line, step: float) -> Line:
    """The same line in equal pieces of at most `step`."""
    length = arc_lengths(line)
    count = max(math.ceil(length[-1] / step - 1e-9), 1)
    places = np.linspace(0.0, length[-1], count + 1)
    return np.stack([np.interp(places, length, line[:, axis]) for axis in range(2)], axis=1)


def arc_lengths(line: Line) -> Float[np.ndarray, " _"]:
    """Arc length of every point from the first."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])


def beside(line: Line, left: float) -> Line:
    """The parallel line `left` metres to the left (negative: right); a closed line stays closed."""
    return line + left * normals(line)


def normals(line: Line) -> Line:
    """Unit vectors to the left at every point: the mean of both neighbouring pieces' normals."""
    pieces = np.diff(line, axis=0)
    pieces = pieces / np.linalg.norm(pieces, axis=1, keepdims=True)
    closed = bool(np.allclose(line[0], line[-1]))
    first, last = (pieces[-1:], pieces[:1]) if closed else (pieces[:1], pieces[-1:])
    along = np.concatenate([first, pieces]) + np.concatenate([pieces, last])
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    return np.stack([-along[:, 1], along[:, 0]], axis=1)


def distance_to(line: Line, points: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, " m"]:
    """Distance of each point to the line."""
    start, piece = line[:-1], np.diff(line, axis=0)
    length2 = np.maximum((piece**2).sum(1), 1e-18)
    offset = points[:, None] - start[None]
    share = np.clip((offset * piece).sum(-1) / length2, 0.0, 1.0)
    return np.linalg.norm(offset - share[..., None] * piece, axis=-1).min(axis=1)
