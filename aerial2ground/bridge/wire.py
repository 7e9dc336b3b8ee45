"""What a motor controller heard, in numbers: checks of a bridge are made on its bytes, not on what it meant to send.

Times are monotonic seconds; values are erpm, amperes and servo positions (0 to 1).
"""

import itertools
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from aerial2ground.guard.vesc import ALIVE, FW_VERSION, GET_VALUES, SET_BRAKE, SET_CURRENT, SET_RPM, SET_SERVO

SET_DUTY, SET_POS, SET_HANDBRAKE, SET_CURRENT_REL = 5, 9, 10, 84
_DRIVING = (SET_DUTY, SET_CURRENT, SET_RPM, SET_CURRENT_REL)
"""Set-points that drive the motor unless they are 0; SET_POS always does."""
_SCALES = {SET_DUTY: 1e5, SET_CURRENT: 1e3, SET_BRAKE: 1e3, SET_RPM: 1.0, SET_POS: 1e6, SET_HANDBRAKE: 1e3}
_SCALES |= {SET_SERVO: 1e3, SET_CURRENT_REL: 1e5}
_ALLOWED = (FW_VERSION, GET_VALUES, SET_CURRENT, SET_BRAKE, SET_RPM, SET_SERVO)


@dataclass(frozen=True)
class Received:
    """One whole frame that arrived."""

    time: float
    """Monotonic seconds at which its last byte was read."""
    payload: bytes
    """Command id and arguments."""

    @property
    def kind(self) -> int:
        """The command's id."""
        return self.payload[0]

    @property
    def value(self) -> float:
        """Erpm, amperes, servo position, degrees or share of the full duty; NaN for a command without a number."""
        scale = _SCALES.get(self.kind)
        layout = ">h" if self.kind == SET_SERVO else ">i"
        if scale is None or len(self.payload) != 1 + struct.calcsize(layout):
            return math.nan
        return struct.unpack_from(layout, self.payload, 1)[0] / scale


def of_kind(received: Sequence[Received], kind: int) -> list[Received]:
    """Returns the frames of one command."""
    return [one for one in received if one.kind == kind]


def motion_frames(received: Sequence[Received]) -> list[Received]:
    """Returns the frames that drive the motor: speed, duty or current other than 0, and every position."""
    return [one for one in received if one.kind == SET_POS or (one.kind in _DRIVING and one.value != 0)]


def brake_frames(received: Sequence[Received]) -> list[Received]:
    """Returns the frames that brake with a current other than 0."""
    return [one for one in of_kind(received, SET_BRAKE) if one.value != 0]


def has_alive(received: Sequence[Received]) -> bool:
    """Whether ALIVE was sent, which keeps the last command alive and must never be."""
    return any(one.kind == ALIVE for one in received)


def strangers(received: Sequence[Received]) -> list[Received]:
    """Returns the frames that no bridge may send: neither questions nor current, brake, speed or servo."""
    return [one for one in received if one.kind not in _ALLOWED]


def first_brake_after(received: Sequence[Received], start: float, quiet: float = 0.5) -> float:
    """Returns seconds from `start` to the first brake that no motion frame follows within `quiet` s; inf: none."""
    motions = [one.time for one in motion_frames(received)]
    for brake in brake_frames(received):
        if brake.time >= start and not any(brake.time <= motion <= brake.time + quiet for motion in motions):
            return brake.time - start
    return math.inf


def periods(received: Sequence[Received], kind: int | None = None) -> list[float]:
    """Returns the seconds between one frame and the next, of one command or of all."""
    times = [one.time for one in received if kind is None or one.kind == kind]
    return [after - before for before, after in itertools.pairwise(times)]


def max_gap(received: Sequence[Received], kind: int | None = None) -> float:
    """Returns the longest silence between two frames, seconds; 0 where there are fewer than two."""
    return max(periods(received, kind), default=0.0)


def steepest(received: Sequence[Received], kind: int, window: float = 0.25, growth: bool = False) -> float:
    """Returns the largest change of a set-point within any `window` seconds, per second of the window.

    A limiter that adds `rate * period` a frame shows up to `rate * (1 + period / window)`: both ends of a window count.
    With `growth` only growing magnitudes count: braking is free. A brake or a current of 0 is a speed of 0.
    """
    zero = (SET_BRAKE, SET_CURRENT) if kind == SET_RPM else ()
    points = [(one.time, 0.0 if one.kind in zero else one.value) for one in received if one.kind in (kind, *zero)]
    largest, first = 0.0, 0
    for index, (time, value) in enumerate(points):
        while points[first][0] < time - window:
            first += 1
        for _, earlier in points[first:index]:
            change = _growth(earlier, value) if growth else abs(value - earlier)
            largest = max(largest, change)
    return largest / window


def _growth(before: float, after: float) -> float:
    """How much the magnitude grew; through 0 the whole new magnitude."""
    return abs(after) if before * after < 0 else abs(after) - abs(before)
