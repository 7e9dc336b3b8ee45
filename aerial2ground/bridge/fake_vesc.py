"""A motor controller without a motor: a VESC behind a pseudo terminal, exact to the byte, with what a car does.

Frames and answers are those of the firmware's comm/packet.c and comm/commands.c, the timeout that of timeout.c. It
stays on when its cable is pulled, as the real one does: it runs from the car's battery.
"""

import contextlib
import heapq
import itertools
import math
import os
import queue
import random
import select
import struct
import threading
import time
import tty
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from aerial2ground.bridge.wire import SET_CURRENT_REL, SET_DUTY, SET_HANDBRAKE, SET_POS, Received
from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.vesc import (
    ALIVE,
    FW_VERSION,
    GET_VALUES,
    SET_BRAKE,
    SET_CURRENT,
    SET_RPM,
    SET_SERVO,
    VALUES,
    FrameParser,
    frame,
)
from hashnerf.errors import UserError

FEEDING = (SET_DUTY, SET_CURRENT, SET_BRAKE, SET_RPM, SET_POS, SET_HANDBRAKE, ALIVE, SET_CURRENT_REL)
"""Commands that keep the firmware's timeout from striking; SET_SERVO and questions do not."""
LOWEST_ERPM = 900
"""Set-points below it do not start a motor, and brake one that turns (s_pid_min_erpm)."""
ACCELERATION, COASTING, PER_AMPERE = 3.0, 0.3, 0.3
"""m/s^2 of the speed controller and of the strongest brake, of a rolling car, and of one ampere."""
SERVO_RATE = 3.2
"""rad/s."""
CHECK, STEP, IDLE = 0.01, 0.005, 0.002
"""Seconds between looks at the timeout, of one step of the motion at most, and of waiting for bytes at most."""
KEPT = 200_000
"""Frames that are remembered."""

Mode = Literal["answer", "silent", "echo"]
OnMotion = Callable[[float, float, float], None]


@dataclass(frozen=True)
class MotorState:
    """One moment of motor and servo."""

    time: float
    """Monotonic seconds."""
    speed: float
    """m/s."""
    steering: float
    """Radians to the left."""
    distance: float
    """Metres rolled since the start, less those rolled backwards."""
    timed_out: bool
    """Whether the controller's own timeout has struck."""


class Motor:
    """What a controller with its motor, servo and car does with commands; time is told to it, seconds."""

    def __init__(self, car: Actuation, timeout: float | None, timeout_brake_current: float, now: float) -> None:
        self.car, self.timeout, self.timeout_brake_current = car, timeout, timeout_brake_current
        self.speed = self.distance = 0.0
        self.steering = self.wanted_steering = (0.5 - car.servo_offset) / car.servo_gain  # firmware boots at 0.5
        self.timed_out = self.kill_switch = False
        self.speed_factor = 1.0
        """The motor turns this many times as fast as it is told; 0: it is stuck."""
        self.runaway_erpm: float | None = None
        """Where given, the motor goes for this speed whatever it is told."""
        self.on_motion: OnMotion = lambda way, steering, now: None
        """Told metres rolled, steering (rad) and time after every step."""
        self._set_point, self._value = SET_CURRENT, 0.0
        self._now, self._fed, self._next_check = now, now, now + CHECK

    @property
    def erpm(self) -> int:
        """Electrical revolutions per minute."""
        return round(self.car.erpm(self.speed))

    def feed(self, payload: bytes, now: float) -> None:
        """Puts the timeout off where a command does so."""
        if payload[0] in FEEDING:
            self._fed = now

    def obey(self, received: Received) -> None:
        """Takes a command in; any other frame is ignored, and so is a command without its number."""
        value = received.value
        if math.isnan(value) or self.kill_switch:
            return
        if received.kind == SET_SERVO:
            self.wanted_steering = (min(max(value, 0.0), 1.0) - self.car.servo_offset) / self.car.servo_gain
        else:
            self._set_point, self._value = received.kind, value

    def advance(self, now: float) -> None:
        """Moves on to `now`."""
        while self._now < now:
            until = min(now, self._now + STEP, self._next_check)
            if until >= self._next_check:
                self._next_check += CHECK
                self._check(until)
            self._move(until - self._now, until)
            self._now = until

    def _check(self, now: float) -> None:
        self.timed_out = self.timeout is not None and now - self._fed > self.timeout
        if self.timed_out or self.kill_switch:
            self._set_point, self._value = SET_BRAKE, self.timeout_brake_current

    def _move(self, seconds: float, now: float) -> None:
        target, rate = self._aim()
        turn = SERVO_RATE * seconds
        self.steering += min(max(self.wanted_steering - self.steering, -turn), turn)
        changing = min(seconds, abs(target - self.speed) / rate)
        reached = self.speed + math.copysign(rate * changing, target - self.speed)
        if changing < seconds:
            reached = target
        way = (self.speed + reached) / 2 * changing + reached * (seconds - changing)
        self.speed = reached
        self.distance += way
        self.on_motion(way, self.steering, now)

    def _aim(self) -> tuple[float, float]:
        """The speed (m/s) that the motor goes for, and how fast it changes (m/s^2)."""
        if self.runaway_erpm is not None:
            return self.car.speed(self.runaway_erpm), ACCELERATION
        if self._set_point == SET_RPM:
            slow = abs(self._value) < LOWEST_ERPM
            return (0.0 if slow else self.car.speed(self._value) * self.speed_factor), ACCELERATION
        strength = min(PER_AMPERE * abs(self._value), ACCELERATION)
        if self._set_point == SET_CURRENT and strength > COASTING:
            return math.copysign(math.inf, self._value), strength
        braking = self._set_point in (SET_BRAKE, SET_HANDBRAKE)
        return 0.0, max(strength, COASTING) if braking else COASTING


class FakeVesc:
    """A VESC on a pseudo terminal with a thread of its own; a context manager.

    `port` is what a bridge opens; `link`, where given, is a symbolic link that always leads there. Attributes may be
    changed while it runs. Raises UserError where `link` is something else than a link.
    """

    def __init__(
        self,
        car: Actuation | None = None,
        *,
        firmware: tuple[int, int, str] | None = (6, 2, "FAKE"),
        mode: Mode = "answer",
        timeout: float | None = 0.2,
        timeout_brake_current: float = 10.0,
        with_status: bool = True,
        delay: float = 0.002,
        drop: float = 0.0,
        corrupt: float = 0.0,
        seed: int = 0,
        link: Path | None = None,
    ) -> None:
        if link is not None and link.exists() and not link.is_symlink():
            raise UserError(f"{link}: is there and no link; name one that may be replaced")
        self.firmware = firmware
        """Version and hardware's name; None: it answers nothing, like something that is no VESC."""
        self.mode: Mode = mode if firmware else "silent"
        """Whether it answers, only reads, or sends back what it reads."""
        self.with_status, self.delay, self.drop, self.corrupt = with_status, delay, drop, corrupt
        """Whether values have the status byte; seconds to an answer, shares of answers lost and with a wrong bit."""
        self.voltage, self.fault, self.temperature = 11.8, 0, 30.0
        """Volts, code, degrees Celsius."""
        self.stalled = False
        """Whether it leaves what is written to it unread."""
        self.unsent = 0
        """Bytes of answers that nobody made room for."""
        self.motor = Motor(car or Actuation(), timeout, timeout_brake_current, time.monotonic())
        self.link = link
        self._received: deque[Received] = deque(maxlen=KEPT)
        self._lock = threading.Lock()
        self._parser = FrameParser()
        self._chance = random.Random(seed)
        self._answers: list[tuple[float, int, bytes]] = []
        self._numbers = itertools.count()
        self._orders: queue.Queue[tuple[Callable[[], None], threading.Event]] = queue.Queue()
        self._closing = threading.Event()
        self._master = self._slave = -1
        self._port = ""
        self._plug()
        self._state = self._snapshot(time.monotonic())
        self._thread = threading.Thread(target=self._run, name="fake VESC", daemon=True)
        self._thread.start()

    def __enter__(self) -> "FakeVesc":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends the thread and closes the terminal."""
        self._closing.set()
        self._thread.join()
        self._unplug()  # only now: numbers of closed files are used again at once

    @property
    def port(self) -> str:
        """The terminal's path; that of the last one while it is unplugged."""
        return self._port

    @property
    def state(self) -> MotorState:
        """Motor and servo as they are now."""
        return self._state

    @property
    def received(self) -> list[Received]:
        """Every whole frame since the start or the last `take`, at most the last 200,000."""
        with self._lock:
            return list(self._received)

    def take(self) -> list[Received]:
        """Returns what was received, and forgets it."""
        with self._lock:
            taken = list(self._received)
            self._received.clear()
            return taken

    @property
    def dropped(self) -> int:
        """Bytes that belonged to no whole frame."""
        return self._parser.dropped

    @property
    def plugged(self) -> bool:
        """Whether there is a terminal."""
        return self._master >= 0

    def stall_reads(self) -> None:
        """Reads no more, so that the writer's buffer fills."""
        self.stalled = True

    def clog(self) -> None:
        """Reads no more, and what the system keeps for it is full: a writer is held up at once."""
        self.stall_reads()
        self._do(self._fill)

    def _fill(self) -> None:
        os.set_blocking(self._slave, False)
        for size in (4096, 4096, 1, 1):  # the system moves bytes on for a moment, which makes room again
            with contextlib.suppress(BlockingIOError):
                while True:
                    os.write(self._slave, bytes(size))
            time.sleep(0.02)

    def answer(self) -> None:
        """Reads and answers again."""
        self.stalled, self.mode = False, "answer"

    def garbage(self, data: bytes) -> None:
        """Sends bytes as they are."""
        self._do(lambda: self._send(data))

    def disconnect(self) -> None:
        """Pulls the cable: the terminal is gone, the motor goes on as its timeout lets it."""
        self._do(self._unplug)

    def reconnect(self) -> None:
        """Plugs in again, as a new terminal."""
        self._do(self._plug)

    def _do(self, work: Callable[[], None]) -> None:
        """Lets the thread do something and waits for it: only the thread touches the terminal."""
        done = threading.Event()
        self._orders.put((work, done))
        if self._closing.is_set() or not done.wait(10):
            raise RuntimeError("the fake VESC is closed")

    def _plug(self) -> None:
        if self.plugged:
            return
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._port = os.ttyname(self._slave)
        self._parser = FrameParser()
        if self.link is not None:
            beside = self.link.with_name(f".{self.link.name}.{os.getpid()}")
            beside.unlink(missing_ok=True)
            beside.symlink_to(self._port)
            beside.replace(self.link)

    def _unplug(self) -> None:
        if not self.plugged:
            return
        if self.link is not None:
            self.link.unlink(missing_ok=True)
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1
        self._answers.clear()

    def _run(self) -> None:
        while not self._closing.is_set():
            data = self._read()
            now = time.monotonic()
            payloads = self._parser.feed(data, now)
            if data and self.mode == "echo":
                self._send(data)
            for payload in payloads:  # first, or a thread that was held up would see a timeout that there was not
                self.motor.feed(payload, now)
            self.motor.advance(now)
            for payload in payloads:
                self._hear(Received(now, payload))
            while self._answers and self._answers[0][0] <= now:
                self._send(heapq.heappop(self._answers)[2])
            self._state = self._snapshot(now)
            while not self._orders.empty():
                work, done = self._orders.get()
                work()
                done.set()

    def _snapshot(self, now: float) -> MotorState:
        motor = self.motor
        return MotorState(now, motor.speed, motor.steering, motor.distance, motor.timed_out)

    def _read(self) -> bytes:
        if self.stalled or not self.plugged:
            time.sleep(IDLE)
            return b""
        ready, _, _ = select.select([self._master], [], [], IDLE)
        return os.read(self._master, 65536) if ready else b""

    def _send(self, data: bytes) -> None:
        sent = 0
        if self.plugged:
            with contextlib.suppress(BlockingIOError):
                sent = os.write(self._master, data)
        self.unsent += len(data) - sent

    def _hear(self, received: Received) -> None:
        with self._lock:
            self._received.append(received)
        self.motor.obey(received)
        if self.mode != "answer" or received.kind not in (FW_VERSION, GET_VALUES):
            return
        answer = bytearray(frame(self._version() if received.kind == FW_VERSION else self._values()))
        if self._chance.random() < self.drop:
            return
        if self._chance.random() < self.corrupt:
            answer[self._chance.randrange(len(answer))] ^= 1 << self._chance.randrange(8)
        heapq.heappush(self._answers, (received.time + self.delay, next(self._numbers), bytes(answer)))

    def _version(self) -> bytes:
        major, minor, name = self.firmware or (0, 0, "")
        # 12 bytes of serial number, then: not paired, no test version, hardware is a VESC, no custom config
        return bytes([FW_VERSION, major, minor]) + name.encode() + b"\0" + bytes(range(12)) + bytes(4)

    def _values(self) -> bytes:
        motor = self.motor
        status = motor.timed_out | motor.kill_switch << 1
        told = {0: GET_VALUES, 1: round(self.temperature * 10), 8: motor.erpm, 9: round(self.voltage * 10)}
        told |= {16: self.fault, 24: status}
        payload = struct.pack(VALUES, *(told.get(index, 0) for index in range(25)))
        return payload if self.with_status else payload[:-1]
