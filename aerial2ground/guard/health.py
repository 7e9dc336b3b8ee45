"""Whether the policy's commands, its pictures and the motor controller can be trusted at this moment.

Each watch answers three questions: is it `slow` (hold the steering, slow down), what is its `fault` (brake), and what
`lacks` before the car may be armed.
"""

import math
from collections import deque
from collections.abc import Iterator

from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.faults import Fault
from aerial2ground.guard.messages import Command, unpack
from aerial2ground.guard.vesc import Values

COMMAND_SLOW, COMMAND_OLD = 0.1, 0.12
PICTURE_SLOW, PICTURE_OLD = 0.15, 0.25
VALUES_SLOW, VALUES_OLD = 0.3, 0.5
"""Seconds. A command is old 30 ms before the 150 within which the car must brake: a period may pass meanwhile."""
SAME_PICTURES = 10
FRESH_PICTURES, FRESH_WITHIN = 10, 0.5
BATTERY_SECONDS, MISMATCH_SECONDS = 0.5, 1.0
MISMATCH_SHARE, MISMATCH_SPEED = 0.3, 0.3
"""Accepted difference of the measured speed: of the commanded one, and m/s."""
STILL = 100
"""Electrical revolutions per minute below which the wheels stand."""


class Since:
    """For how long something has been so."""

    def __init__(self) -> None:
        self._start = math.inf

    def __call__(self, so: bool, now: float) -> float:
        """Returns for how many seconds `so` has held; 0 when it does not."""
        self._start = min(self._start, now) if so else math.inf
        return now - self._start if so else 0.0


class CommandWatch:
    """The policy's commands and the pictures that they are based on."""

    def __init__(self, actuation: Actuation):
        self.command: Command | None = None
        self._car = actuation
        self._new_at = -math.inf
        """When the picture was taken since which nothing new was seen."""
        self._same = 0
        self._fresh: deque[float] = deque(maxlen=FRESH_PICTURES)

    def accept(self, message: bytes, now: float) -> str:
        """Takes a message in; returns what is wrong with it, empty where nothing is: then it is the command."""
        command, last = unpack(message), self.command
        if command is None:
            return f"a message of {len(message)} bytes that is damaged"
        wrong = self._wrong(command, last, now)
        if wrong:
            return wrong
        if last is None or command.picture != last.picture:
            self._new_at, self._same = command.taken, 1
            self._fresh.append(command.taken)
        elif command.taken > last.taken:
            self._same += 1  # taken anew and yet the same to the bit: it tells nothing new, so its age counts on
        self.command = command
        return ""

    def _wrong(self, command: Command, last: Command | None, now: float) -> str:
        # written so that NaN fails every one of them
        if not abs(command.steering) <= self._car.steering_limit:
            return f"steering {command.steering:.6g} rad, beyond {self._car.steering_limit}"
        if not 0 <= command.speed <= self._car.speed_limit:
            return f"speed {command.speed:.6g} m/s, not from 0 to {self._car.speed_limit}"
        if not command.taken <= command.sent <= now:
            return "a picture or command from the future"
        if last is not None and not (
            command.number > last.number and command.taken >= last.taken and command.sent >= last.sent
        ):
            return "commands out of order"
        return ""

    def slow(self, now: float) -> bool:
        """Whether command or picture come late."""
        return self.command is None or now - self.command.sent > COMMAND_SLOW or now - self._new_at > PICTURE_SLOW

    def fault(self, now: float) -> Fault | None:
        """What is wrong with them."""
        if self.command is None or now - self.command.sent > COMMAND_OLD:
            return Fault.POLICY_SILENT
        if self._same >= SAME_PICTURES:
            return Fault.PICTURES_FROZEN
        return Fault.PICTURES_OLD if now - self._new_at > PICTURE_OLD else None

    def lacks(self, now: float) -> Iterator[str]:
        """What is missing before the car may be armed."""
        fresh = sum(now - taken <= FRESH_WITHIN for taken in self._fresh)
        if fresh < FRESH_PICTURES:
            yield f"{FRESH_PICTURES} different pictures in the last half second (there were {fresh})"
        if self.slow(now):
            yield "fresh commands of the policy"
        elif self.command is not None and self.command.speed != 0:
            yield "a policy that asks for no speed before the car is armed"


class ControllerWatch:
    """What the motor controller says about itself."""

    def __init__(self, actuation: Actuation):
        self.values: Values | None = None
        self.at = -math.inf
        self._car = actuation
        self._battery, self._mismatch, self._still = Since(), Since(), Since()

    def accept(self, values: Values, now: float) -> None:
        """Takes an answer in."""
        self.values, self.at = values, now

    def age(self, now: float) -> float:
        """Seconds since the last answer; infinite before the first."""
        return now - self.at

    def speed(self, now: float) -> float:
        """How fast the wheels turn, m/s; infinite where that is not known."""
        if self.values is None or self.age(now) > VALUES_SLOW:
            return math.inf
        return self._car.speed(self.values.erpm)

    def still_for(self, now: float) -> float:
        """For how many seconds the wheels have stood; to be asked every period."""
        speed = self.speed(now)
        return self._still(abs(self._car.erpm(speed)) < STILL, now)

    def fault(self, commanded: float, now: float) -> Fault | None:
        """What is wrong at a commanded speed (m/s); to be asked every period."""
        values = self.values
        if values is None or self.age(now) > VALUES_OLD:
            return Fault.ESC_SILENT
        empty = not self._car.lowest_voltage <= values.voltage <= self._car.highest_voltage
        out_of_range = self._battery(empty, now) >= BATTERY_SECONDS
        allowed = MISMATCH_SHARE * commanded + MISMATCH_SPEED
        apart = abs(self._car.speed(values.erpm) - commanded) > allowed
        apart_for = self._mismatch(apart, now)
        if values.fault:
            return Fault.ESC_FAULT
        if values.status is not None and values.status & 2:
            return Fault.KILL_SWITCH
        if values.temperature > self._car.highest_temperature:
            return Fault.ESC_HOT
        if out_of_range:
            return Fault.BATTERY
        return Fault.SPEED_MISMATCH if apart_for >= MISMATCH_SECONDS else None

    def lacks(self, now: float) -> Iterator[str]:
        """What is missing before the car may be armed."""
        values = self.values
        if values is None or self.age(now) > VALUES_SLOW:
            yield "answers of the motor controller"
            return
        if values.fault:
            yield f"a motor controller without fault (its code is {values.fault})"
        if values.status is not None and values.status & 2:
            yield "a released kill switch"
        if values.temperature > self._car.highest_temperature:
            yield f"a controller below {self._car.highest_temperature:g} degrees (it has {values.temperature:g})"
        if not self._car.lowest_voltage <= values.voltage <= self._car.highest_voltage:
            limits = f"{self._car.lowest_voltage:g} to {self._car.highest_voltage:g} V"
            yield f"a battery of {limits} (it has {values.voltage:g})"
        if abs(values.erpm) >= STILL:
            yield f"wheels that stand (they turn at {values.erpm} erpm)"
