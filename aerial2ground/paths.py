"""Paths on the ground: closed or open lines with arc length, heading and the nearest place (metres, radians)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from hashnerf.errors import UserError


@dataclass(frozen=True)
class Path:
    """A line through `points`; a closed one repeats its first point at the end."""

    points: Float[np.ndarray, "n 2"]

    def __post_init__(self):
        if len(self.points) < 2 or self.length <= 0:
            raise UserError("a path needs two or more points that differ")
        if not np.isfinite(self.points).all():
            raise UserError("a path holds a point that is not finite")

    @cached_property
    def _arc(self) -> np.ndarray:
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))])

    @property
    def length(self) -> float:
        """Metres from the first to the last point."""
        return float(self._arc[-1])

    @property
    def closed(self) -> bool:
        """Whether the path ends where it begins."""
        return bool(np.allclose(self.points[0], self.points[-1]))

    def wrapped(self, s: float | Float[np.ndarray, " n"]) -> float | Float[np.ndarray, " n"]:
        """Arc lengths on the path: round and round on a closed one, up to its ends on an open one."""
        return np.mod(s, self.length) if self.closed else np.clip(s, 0.0, self.length)

    def at(self, s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Points at arc lengths."""
        place = self.wrapped(s)
        return np.stack([np.interp(place, self._arc, self.points[:, axis]) for axis in range(2)], axis=1)

    def poses(self, s: Float[np.ndarray, " n"], step: float = 0.05) -> Float[np.ndarray, "n 3"]:
        """(x, y, yaw) at arc lengths; the heading is that of the chord over `step` metres."""
        ahead, behind = self.at(s + step / 2), self.at(s - step / 2)
        along = ahead - behind
        return np.column_stack([self.at(s), np.arctan2(along[:, 1], along[:, 0])])

    def nearest(self, point: Float[np.ndarray, " 2"]) -> tuple[float, float]:
        """Arc length of the place nearest to `point`, and how far left of the path the point is (m)."""
        start, step = self.points[:-1], np.diff(self.points, axis=0)
        square = np.maximum((step**2).sum(axis=1), 1e-18)
        share = np.clip(((point - start) * step).sum(axis=1) / square, 0.0, 1.0)
        offset = point - start - share[:, None] * step
        best = int(np.argmin((offset**2).sum(axis=1)))
        side = step[best, 0] * (point - start[best])[1] - step[best, 1] * (point - start[best])[0]
        distance = float(np.linalg.norm(offset[best]))
        return float(self._arc[best] + share[best] * np.sqrt(square[best])), distance if side >= 0 else -distance
