"""What a long drive on the rig shows: the set-points' period beside other work, and a reply path full of noise."""

import os
import random
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aerial2ground.bridge.rig import Rig
from aerial2ground.bridge.wire import Received, max_gap, motion_frames, of_kind, periods, steepest, strangers
from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.vesc import FW_VERSION, GET_VALUES, SET_RPM, SET_SERVO, VALUES, frame
from hashnerf.errors import UserError

CHUNK = 1024
CALM = 0.05
"""Bytes of noise at once, and seconds between: a terminal holds a few thousand bytes."""


@dataclass(frozen=True)
class Period:
    """Milliseconds between two set-points of the speed, as the controller received them."""

    seconds: float
    busy: int
    """Processes that did nothing but count meanwhile."""
    median: float
    p99: float
    longest: float
    damaged: int
    """Bytes that belonged to no whole frame."""
    faults: int


def period(rig: Rig, seconds: float, busy: int) -> Period:
    """Measures a drive of so many seconds beside so many busy processes; the rig is armed for it."""
    with ExitStack() as stack:
        for _ in range(busy):
            hog = subprocess.Popen([sys.executable, "-c", "while True: pass"])
            stack.callback(hog.wait)
            stack.callback(hog.kill)
        rig.arm()
        begun = time.monotonic()
        rig.vesc.take()
        time.sleep(seconds)
        received = rig.vesc.take()
    rig.hold(False)
    times = 1000 * np.array(periods(received, SET_RPM))
    if not len(times):
        raise UserError("the car did not drive; the black box says why")
    faults = sum("STOPPING" in line and "let go" not in line for moment, line in rig.heard if moment >= begun)
    numbers = (float(np.median(times)), float(np.percentile(times, 99)), 1000 * max_gap(received, SET_RPM))
    return Period(seconds, busy, *numbers, rig.vesc.dropped, faults)


@dataclass(frozen=True)
class Noise:
    """What a million bytes of noise on the reply path did."""

    sent: int
    alive: bool
    """Whether the bridge still ran and said what it was told to say."""
    growth: float
    """Megabytes of the guard's memory."""
    outside: int
    """Frames beyond the car's limits, or of a kind that the bridge does not send."""


def noise(rig: Rig, count: int, seed: int = 0) -> Noise:
    """Sends so many random and damaged bytes to a driving car's bridge."""
    rig.arm()
    before, chance, sent = resident(rig.bridge.pid), random.Random(seed), 0
    while sent < count:
        unsent = rig.vesc.unsent
        data = chance.randbytes(CHUNK) if chance.random() < 0.5 else damaged_answers(chance)
        rig.vesc.garbage(data)
        sent += len(data) - (rig.vesc.unsent - unsent)
        time.sleep(CALM * CHUNK / 4096)
    rig.press(" ")
    rig.wait_for(lambda: rig.said("FAULT"), "an emergency stop")
    grown = (resident(rig.bridge.pid) - before) / 1e6
    return Noise(sent, rig.bridge.poll() is None, grown, beyond(rig.vesc.received, rig.vesc.motor.car))


def damaged_answers(chance: random.Random) -> bytes:
    """Returns answers with one bit wrong each, cut anywhere."""
    data = bytearray()
    while len(data) < CHUNK:
        kind = chance.choice((FW_VERSION, GET_VALUES))
        answer = bytearray(frame(bytes([kind]) + chance.randbytes(len(VALUES) * 2 + 20)))
        answer[chance.randrange(len(answer))] ^= 1 << chance.randrange(8)
        data += answer[: chance.randrange(1, len(answer) + 1)]
    return bytes(data)


def beyond(received: Sequence[Received], car: Actuation) -> int:
    """How many frames ask for more than the car may, or for what no bridge asks."""
    fast = [one for one in motion_frames(received) if not 0 <= one.value <= car.erpm(car.speed_limit) + 1]
    servos = sorted((car.servo(-car.steering_limit), car.servo(car.steering_limit)))
    turned = [one for one in of_kind(received, SET_SERVO) if not servos[0] - 1e-3 <= one.value <= servos[1] + 1e-3]
    return len(fast) + len(turned) + len(strangers(received))


def steepest_rates(received: Sequence[Received], car: Actuation) -> dict[str, float]:
    """Returns the fastest steering (rad/s) and growth of speed (m/s^2) over any quarter of a second on the wire."""
    return {
        "steering": steepest(received, SET_SERVO) / abs(car.servo_gain),
        "speed": steepest(received, SET_RPM, growth=True) / car.speed_to_erpm_gain,
    }


def resident(process: int) -> int:
    """Returns how many bytes of a process are in memory."""
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
