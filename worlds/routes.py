"""Routes: paths on the ground as functions of arc length (metres), and what closed-loop driving needs to know."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from hashnerf.errors import UserError
from worlds.boxes import Box, Pose, box_at, wrap_angle

Size = tuple[float, float, float]
CONFLICT_STEP = 0.25
"""Arc length between the samples of a conflict zone, metres."""


@dataclass(frozen=True)
class Route:
    """A polyline; `s` is the arc length from its first point, and beyond both ends it goes straight on."""

    points: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        if len(self.points) < 2 or any(a == b for a, b in zip(self.points, self.points[1:])):
            raise UserError(f"a route needs two or more points, each different from the one before; got {self.points}.")

    @cached_property
    def _segments(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Vector, length and start s of every segment."""
        delta = np.diff(np.array(self.points), axis=0)
        lengths = np.hypot(delta[:, 0], delta[:, 1])
        return delta, lengths, np.concatenate([[0.0], np.cumsum(lengths)[:-1]])

    @property
    def length(self) -> float:
        """Arc length from the first to the last point, metres."""
        return float(self._segments[1].sum())

    def pose(self, s: float) -> Pose:
        """Where a body stands at arc length `s` (metres); the heading turns evenly between the middles of segments."""
        delta, lengths, starts = self._segments
        segment = int(np.clip(np.searchsorted(starts, s, side="right") - 1, 0, len(lengths) - 1))
        x, y = np.array(self.points)[segment] + (s - starts[segment]) / lengths[segment] * delta[segment]
        heading = np.unwrap(np.arctan2(delta[:, 1], delta[:, 0]))
        yaw = float(np.interp(s, starts + lengths / 2, heading))
        return Pose(float(x), float(y), 0.0, wrap_angle(yaw))

    def nearest(self, x: float, y: float) -> float:
        """The arc length of the point of the route that is closest to (x, y)."""
        delta, lengths, starts = self._segments
        offset = np.array([x, y]) - np.array(self.points)[:-1]
        share = (offset * delta).sum(1) / lengths**2
        low, high = np.zeros(len(lengths)), np.ones(len(lengths))
        low[0], high[-1] = -np.inf, np.inf  # the ends go straight on
        share = np.clip(share, low, high)
        distance = np.linalg.norm(offset - share[:, None] * delta, axis=1)
        best = int(distance.argmin())
        return float(starts[best] + share[best] * lengths[best])


def straight(start: tuple[float, float], yaw: float, length: float) -> Route:
    """A straight route of `length` metres."""
    return Route((start, (start[0] + length * math.cos(yaw), start[1] + length * math.sin(yaw))))


def curve(
    start: tuple[float, float], control: tuple[float, float], end: tuple[float, float], pieces: int = 16
) -> list[tuple[float, float]]:
    """Points of a quadratic curve that leaves `start` towards `control` and arrives at `end` from it."""
    share = np.linspace(0.0, 1.0, pieces + 1)[:, None]
    points = (1 - share) ** 2 * np.array(start) + 2 * share * (1 - share) * np.array(control) + share**2 * np.array(end)
    return [(float(x), float(y)) for x, y in points]


def conflict_interval(route: Route, size: Size, other: Route, other_size: Size) -> tuple[float, float]:
    """First and last arc length at which a body on `route` touches what another body sweeps along `other`.

    The two routes must meet; sampled every CONFLICT_STEP metres and widened by one step on either side.
    """
    obstacles = [box_at(other.pose(s), other_size) for s in np.arange(0.0, other.length, CONFLICT_STEP)]
    centres = np.array([box.center[:2] for box in obstacles])
    reach = 0.5 * (math.hypot(*size[:2]) + math.hypot(*other_size[:2]))
    touching = []
    for s in np.arange(0.0, route.length, CONFLICT_STEP):
        box = box_at(route.pose(float(s)), size)
        close = np.linalg.norm(centres - np.array(box.center[:2]), axis=1) < reach
        if _any_overlap(box, obstacles, close):
            touching.append(float(s))
    return touching[0] - CONFLICT_STEP, touching[-1] + CONFLICT_STEP


def _any_overlap(box: Box, obstacles: list[Box], close: Float[np.ndarray, " n"] | np.ndarray) -> bool:
    return any(box.overlaps(obstacles[index]) for index in np.flatnonzero(close))


@dataclass(frozen=True)
class Traffic:
    """What driving in closed loop needs, by actor name ("ego" among them); arc lengths are of a body's centre."""

    routes: Mapping[str, Route]
    """The path of each actor."""
    speeds: Mapping[tuple[int, str], float]
    """Nominal speed in m/s by (branch, name); a name is missing in a branch where it is absent."""
    starts: Mapping[tuple[int, int, str], float]
    """Arc length by (branch, step, name): the nominal run passes through the states of the data set."""
    stop: float
    """The ego's arc length with its front at the stop line."""
    conflicts: Mapping[str, tuple[tuple[float, float], tuple[float, float]]]
    """By actor: the ego's and the actor's arc-length interval in which they can touch each other's path."""
    step_seconds: float
    """Seconds from one step to the next."""


def nominal_traffic(
    routes: Mapping[str, Route],
    sizes: Mapping[str, Size],
    states: Sequence[tuple[int, int, Mapping[str, Pose]]],
    stop: float,
    step_seconds: float,
) -> Traffic:
    """Reads the nominal run off states (branch, step, poses): constant speed from first to last step of a branch."""
    starts = {
        (branch, step, name): routes[name].nearest(pose.x, pose.y)
        for branch, step, poses in states
        for name, pose in poses.items()
    }
    last = max(step for _, step, _ in states)
    speeds = {
        (branch, name): (starts[branch, last, name] - start) / (last * step_seconds)
        for (branch, step, name), start in starts.items()
        if step == 0
    }
    ego = (routes["ego"], sizes["ego"])
    conflicts = {
        name: (
            conflict_interval(*ego, routes[name], sizes[name]),
            conflict_interval(routes[name], sizes[name], *ego),
        )
        for name in routes
        if name != "ego"
    }
    return Traffic(routes, speeds, starts, stop, conflicts, step_seconds)
