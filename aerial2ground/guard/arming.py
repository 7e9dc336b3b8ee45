"""What is found out before the car may be armed: the guard's own limits, and whether the controller stops by itself."""

import math
from collections.abc import Iterator

from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.health import CommandWatch
from aerial2ground.guard.messages import Command
from aerial2ground.guard.set_point import PERIOD, SetPoint
from aerial2ground.guard.vesc import GET_VALUES, Values, query, set_current, set_rpm

LONGEST_TIMEOUT = 0.25
"""Seconds after which a controller that hears nothing must brake by itself."""
LONGEST_WAIT = 1.5
RELEASED = 0.08
"""Seconds without a sign of the dead-man after which it counts as let go; with one period more it makes 100 ms."""
HELD, WHEELS = 0.3, 0.7
"""Seconds: how long the dead-man is held before the car may go, and for which the wheels are turned to each side."""


def self_test(actuation: Actuation) -> list[str]:
    """Tries limits and rates on known cases; returns what does not hold, which is nothing in a sound program."""
    failed = []
    if set_rpm(4614.0).hex() != "0205080000120607fa03":
        failed.append("frames")
    limit, fastest = actuation.steering_limit, actuation.speed_limit
    for steering, speed in ((math.nan, 0.0), (0.0, math.nan), (limit * 1.01, 0.0), (0.0, fastest * 1.01), (0.0, -0.01)):
        if not CommandWatch(actuation).accept(Command(1, 1, 1.0, 1.0, steering, speed).packed(), 1.0):
            failed.append(f"refusal of steering {steering:g}, speed {speed:g}")
    point = SetPoint(actuation)
    point.follow(limit, fastest, 1.0)
    if point.steering > actuation.steering_rate * PERIOD + 1e-9 or point.speed > actuation.acceleration * PERIOD + 1e-9:
        failed.append("rates")
    return failed


class TimeoutProbe:
    """Measures after which silence the controller stops by itself: one frame, then only questions until it says so."""

    def __init__(self, accepted: float = 0.0):
        self.seconds: float | None = None
        """The controller's timeout; infinite where it has none or does not tell."""
        self._limit = max(LONGEST_TIMEOUT, accepted)
        self._start: float | None = None
        self._was_clear = False

    def frames(self, now: float) -> list[bytes] | None:
        """Returns what is to be sent for the measurement; None when it is over."""
        if self.seconds is not None:
            return None
        if self._start is None:
            self._start = now
            return [set_current(0.0), query(GET_VALUES)]
        if now - self._start <= LONGEST_WAIT:
            return [query(GET_VALUES)]
        self.seconds = math.inf
        return None

    def begin_anew(self) -> None:
        """Forgets a measurement that is not over."""
        if self.seconds is None:
            self._start, self._was_clear = None, False

    def accept(self, values: Values, now: float) -> None:
        """Takes an answer in."""
        if self._start is None or self.seconds is not None or values.status is None:
            return  # a controller that does not tell runs into the longest wait
        struck = bool(values.status & 1)
        if struck and self._was_clear:
            self.seconds = now - self._start
        self._was_clear = self._was_clear or not struck

    def finding(self) -> str:
        """What was found, as a sentence for the operator; loud where an operator accepted more than is safe."""
        if self.seconds is None or self.seconds == math.inf:
            found = "the motor controller has no timeout of its own, or does not tell"
        else:
            found = f"the motor controller stops by itself after {1000 * self.seconds:.0f} ms of silence"
        accepted = self.seconds is not None and LONGEST_TIMEOUT < self.seconds <= self._limit
        return found + (": ACCEPTED BY THE OPERATOR, IT MAY RUN AWAY WHEN THIS COMPUTER FAILS" if accepted else "")

    def lacks(self) -> Iterator[str]:
        """What is missing before the car may be armed."""
        if self.seconds is None:
            yield "a measurement of the controller's own timeout"
        elif self.seconds > self._limit:
            found = f"{1000 * self.seconds:.0f} ms" if self.seconds < math.inf else "none, or not told"
            yield (
                f"a controller that brakes by itself within {1000 * self._limit:.0f} ms of silence (found: {found}; "
                "set timeout and brake current in VESC Tool, or accept it with --accept_esc_timeout)"
            )


class DeadMan:
    """Whether the operator's hand is on the dead-man."""

    def __init__(self) -> None:
        self.since = -math.inf
        """When it was taken last, after it had been let go."""
        self._sign = -math.inf

    def sign(self, now: float) -> None:
        """A sign that it is held."""
        if not self.is_held(now):
            self.since = now
        self._sign = now

    def release(self) -> None:
        """It is let go."""
        self._sign = -math.inf

    def is_held(self, now: float) -> bool:
        """Whether it is held."""
        return now - self._sign <= RELEASED


class WheelCheck:
    """Turns the wheels left, then right, and has the operator say whether they did."""

    def __init__(self, limit: float):
        self.confirmed = False
        self._limit = limit
        self._start = -math.inf
        self._turned: set[float] = set()
        """Sides to which they were: 0 and 1. None, while nothing can be sent or the car rolls."""

    def begin(self, now: float) -> None:
        """Starts to turn them."""
        self._start, self.confirmed, self._turned = now, False, set()

    def angle(self, now: float) -> float:
        """The steering angle that is asked for, radians."""
        step = (now - self._start) // WHEELS
        if step not in (0, 1):
            return 0.0
        self._turned.add(step)
        return self._limit / 2 if step == 0 else -self._limit / 2

    def answer(self, well: bool, now: float) -> bool:
        """Takes the operator's word; returns whether it was asked for: not before the wheels have turned both ways."""
        asked = {0, 1} <= self._turned and now - self._start >= 2 * WHEELS
        if asked:
            self.confirmed, self._turned = well, set()  # who has said no has to look again
        return asked
