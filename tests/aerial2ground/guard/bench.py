"""A bench for the guard in virtual time: a policy, an operator's hand, a car with inertia, a strict reader of bytes.

Nothing here uses the guard's own protocol code: frames are taken apart and answers put together by other means.
"""

import copy
import functools
import struct
import zlib

from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.guard import Guard, GuardSettings
from aerial2ground.guard.states import State

CAR, DEFAULTS = Actuation(), GuardSettings()
FIRMWARE, ANSWER, CURRENT, BRAKE, RPM, SERVO, ALIVE = 0, 4, 6, 7, 8, 12, 30
WIDTHS = {FIRMWARE: 0, ANSWER: 0, CURRENT: 4, BRAKE: 4, RPM: 4, SERVO: 2}
"""The commands that the guard may send at all, and the bytes of their arguments."""
STEP = 0.02


def _shifted(crc: int) -> int:
    for _ in range(8):
        crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


_TABLE = [_shifted(high << 8) for high in range(256)]


def crc16(data: bytes) -> int:
    """CRC-16/XMODEM, by a table that was made bit by bit."""
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFF00) ^ _TABLE[crc >> 8 ^ byte]
    return crc


@functools.lru_cache(5000)
def taken_apart(data: bytes) -> tuple[tuple[int, int], ...]:
    """Returns (command, argument) of every frame; asserts that there is not one byte too many or too few."""
    found = []
    while data:
        length = data[1]
        payload, crc, stop = data[2 : 2 + length], data[2 + length : 4 + length], data[4 + length]
        assert data[0] == 2 and stop == 3 and len(payload) == length >= 1, data.hex()
        assert int.from_bytes(crc, "big") == crc16(payload), data.hex()
        assert len(payload) == 1 + WIDTHS[payload[0]], f"this command is never sent: {payload.hex()}"
        found.append((payload[0], int.from_bytes(payload[1:], "big", signed=True)))
        data = data[5 + length :]
    return tuple(found)


def is_motion(command: int, argument: int) -> bool:
    """Whether a frame can make the motor turn."""
    return command not in (FIRMWARE, ANSWER, SERVO, BRAKE) and argument != 0


def answer(erpm=0, volts=11.8, fault=0, celsius=30.0, status: int | None = 0) -> bytes:
    """The payload of an answer to GET_VALUES, byte by byte: erpm at 23, volts at 27, fault at 53, status at 73."""
    payload = bytearray(74)
    payload[0] = ANSWER
    struct.pack_into(">h", payload, 1, round(celsius * 10))
    struct.pack_into(">i", payload, 23, round(erpm))
    struct.pack_into(">h", payload, 27, round(volts * 10))
    payload[53] = fault
    payload[73] = status or 0
    return bytes(payload if status is not None else payload[:73])


def command(number, picture, taken, sent, steering=0.0, speed=0.0) -> bytes:
    """The policy's message; written here anew from the layout that is agreed on."""
    body = struct.pack("<IIdddd", number, picture, taken, sent, steering, speed)
    return body + struct.pack("<I", zlib.crc32(body))


class CarModel:
    """A motor controller and its car: 3 m/s^2 under power and brake, 0.3 m/s^2 when it rolls."""

    def __init__(self) -> None:
        self.speed, self.metres, self.timeout, self.firmware = 0.0, 0.0, 0.2, b"\x06\x02bench\x00"
        self.answers, self.told, self.says = True, {}, []
        """Whether it answers; what it says about itself instead of the truth; its answers that have not arrived."""
        self.servo = None
        self._order, self._heard, self._now = (CURRENT, 0), -1e9, None

    def obey(self, frames, now: float) -> None:
        """Takes frames and moves on to `now`."""
        seconds = 0.0 if self._now is None else now - self._now
        self._now = now
        struck = now - self._heard > self.timeout
        kind, value = (BRAKE, 10_000) if struck else self._order
        goal = value / 4614 if kind == RPM else 0.0
        step = (0.3 if kind == CURRENT else 3.0) * seconds
        self.speed += min(max(goal - self.speed, -step), step)
        self.metres += self.speed * seconds
        for kind, value in frames:
            if kind in (CURRENT, BRAKE, RPM):
                self._order, self._heard = (kind, value), now
            elif kind == SERVO:
                self.servo = value / 1000
            elif kind == FIRMWARE and self.answers:
                self.says.append(b"\x00" + self.firmware)
            elif kind == ANSWER and self.answers:
                self.says.append(answer(**{"erpm": self.speed * 4614, "status": int(struck)} | self.told))


class Bench:
    """A guard, its policy, operator and car; every cycle is checked for what must never be sent."""

    def __init__(self, actuation: Actuation = CAR, settings: GuardSettings = DEFAULTS, **told):
        self.car, self.guard = CarModel(), Guard(actuation, settings)
        self.car.told = told
        self.now, self.log, self.notes = 1000.0, [], []
        """`log` holds (time, state, frames) of every cycle, `notes` the guard's sentences."""
        self.steering, self.speed = 0.0, 0.0
        """What the policy wants, once the car is armed."""
        self.policy_lives = self.camera_lives = True
        self.hand = False
        self.happened = self._number = self._picture = 0
        self._taken = self.now

    def say(self, kind: str, value: str = "") -> None:
        """Something happens: a word of the operator, or another kind of event with its value."""
        self.happened += 1
        if value:
            self.guard.take(kind, value, self.now)
        else:
            self.guard.take("word", kind, self.now)

    def send(self, steering=0.0, speed=0.0, **changed) -> None:
        """The policy sends a command on the newest picture; any of its numbers may be another."""
        self._number += 1
        numbers = {"number": self._number, "picture": self._picture, "taken": self._taken, "sent": self.now - 0.001}
        message = command(**numbers | {"steering": steering, "speed": speed} | changed)
        self.say("message", message.hex())

    def look(self) -> None:
        """The camera takes another picture."""
        self._picture += 1
        self._taken = self.now - 0.03

    def events(self) -> None:
        """What happens in one period."""
        for payload in self.car.says:
            self.say("payload", payload.hex())
        self.car.says = []
        if self.camera_lives:
            self.look()
        if self.policy_lives:
            self.send(self.steering, self.speed if self.guard.state is State.ARMED else 0.0)
        if self.hand:
            self.say("held")

    def tick(self) -> tuple[tuple[int, int], ...]:
        """The guard's cycle at this moment; returns its frames."""
        frames = taken_apart(b"".join(self.guard.tick(self.now)))
        state, car = self.guard.state, self.guard._car
        for kind, argument in frames:
            assert not is_motion(kind, argument) or (kind == RPM and state is State.ARMED), (kind, argument, state)
            if kind == RPM:
                assert 0 < argument <= round(car.speed_to_erpm_gain * car.speed_limit), argument
            if kind == SERVO:
                assert round(car.servo_min * 1000) <= argument <= round(car.servo_max * 1000), argument
        self.log.append((self.now, state, frames))
        self.notes += self.guard.notes
        self.guard.notes.clear()
        self.car.obey(frames, self.now)
        return frames

    def run(self, seconds: float, dt: float = STEP):
        """Lets time pass; returns what was logged meanwhile."""
        begun = len(self.log)
        for _ in range(round(seconds / dt)):
            self.now += dt
            self.events()
            self.tick()
        return self.log[begun:]

    def connect(self):
        """Port and policy come, and whatever is measured then; returns itself."""
        self.say("link", "up")
        self.say("message", b"ready".hex())
        self.run(2.0)
        return self

    def look_at_wheels(self):
        """The wheels are tried, and the operator says yes."""
        self.say("check")
        self.run(1.5)
        self.say("yes")
        return self

    def get_ready(self):
        """The operator says arm, with his hand off the dead-man."""
        self.hand = False
        self.run(1.2)
        self.say("arm")
        assert self.state is State.READY, self.guard.notes
        self.run(0.1)
        return self

    def arm(self):
        """From ready for arming to ARMED."""
        if self.state is not State.READY:
            self.get_ready()
        self.hand = True
        self.run(0.4)
        assert self.state is State.ARMED, self.notes
        return self

    def drive(self, speed=1.0, steering=0.0, seconds=1.0):
        """The policy drives for a while."""
        self.speed, self.steering = speed, steering
        self.run(seconds)
        return self

    @property
    def state(self) -> State:
        """The guard's."""
        return self.guard.state

    @property
    def fault(self) -> str:
        """The name of the latched fault, or nothing."""
        return self.guard.fault.name if self.guard.fault else ""

    def lacks(self) -> str:
        """What is missing for arming."""
        return "; ".join(self.guard.lacks(self.now))


@functools.cache
def _stage(stage: str) -> Bench:
    if stage == "connected":
        return Bench().connect()
    before = {"checked": "connected", "ready": "checked", "armed": "ready", "driving": "armed"}[stage]
    bench = copy.deepcopy(_stage(before))
    steps = {"checked": bench.look_at_wheels, "ready": bench.get_ready, "armed": bench.arm, "driving": bench.drive}
    return steps[stage]()


def staged(stage: str) -> Bench:
    """A bench that is `connected`, `checked` (its wheels, too), `ready`, `armed`, or `driving` straight on at 1 m/s."""
    return copy.deepcopy(_stage(stage))


def sent(log, kind: int) -> list[tuple[float, int]]:
    """(time, argument) of all frames of a kind in a log."""
    return [(time, argument) for time, _, frames in log for one, argument in frames if one == kind]


def first(log, kind: int) -> float:
    """When the first frame of a kind was sent; infinite where none was."""
    return next(iter(sent(log, kind)), (float("inf"), 0))[0]
