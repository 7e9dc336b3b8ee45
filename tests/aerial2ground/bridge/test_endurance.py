import random

import pytest

from aerial2ground.bridge.endurance import CHUNK, beyond, damaged_answers, noise, period, resident, steepest_rates
from aerial2ground.bridge.rig import Rig
from aerial2ground.bridge.wire import Received
from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.vesc import FrameParser, frame, set_current, set_rpm, set_servo

CAR = Actuation()


def received(*frames, start=0.0, every=0.02):
    payloads = [FrameParser().feed(one, 0.0)[0] for one in frames]
    return [Received(start + every * number, payload) for number, payload in enumerate(payloads)]


@pytest.mark.parametrize(
    ("data", "count"),
    [
        (set_rpm(4614.0), 0),  # 1 m/s, the limit
        (set_rpm(4620.0), 1),
        (set_rpm(-1.0), 1),
        (set_current(0.1), 0),  # 0.1 is below the 4615 that is asked of a speed: a current is a stranger by its kind
        (set_servo(CAR.servo(0.263)), 0),
        (set_servo(CAR.servo(0.263) - 0.003), 1),
        (set_servo(CAR.servo(-0.263) + 0.003), 1),
        (frame(b"\x1e"), 1),  # ALIVE
    ],
)
def test_frames_beyond_the_limits(data, count):
    assert beyond(received(data), CAR) == count


def test_rates_on_the_wire_by_hand():
    # 0.02 of servo a frame of 20 ms, 12 changes in a window of 0.25 s: 0.24 / 0.25 / 1.2135 per radian
    steering = received(*(set_servo(0.5 + 0.02 * step) for step in range(14)))
    # 100 erpm a frame: 1200 / 0.25 / 4614
    speed = received(*(set_rpm(1000.0 + 100 * step) for step in range(14)))
    rates = steepest_rates([*steering, *speed], CAR)
    assert rates["steering"] == pytest.approx(0.24 / 0.25 / 1.2135)
    assert rates["speed"] == pytest.approx(1200 / 0.25 / 4614)


def test_damaged_answers_are_damaged():
    parser, data = FrameParser(), damaged_answers(random.Random(0))
    assert len(data) >= CHUNK
    parser.feed(data, 0.0)
    assert parser.frames == 0


def test_memory_is_measured(tmp_path):
    import os

    before = resident(os.getpid())
    block = bytearray(b"\1" * 50_000_000)
    assert resident(os.getpid()) - before > 40_000_000
    del block


def test_r09_r20_noise_moves_nothing_and_the_period_is_measured(tmp_path, bridge_row):
    with Rig(tmp_path) as rig:
        rig.confirm_wheels()
        measured = period(rig, 2.0, 0)
        assert measured.median == pytest.approx(20, abs=2) and measured.damaged == 0 and measured.faults == 0
        rig.wait_for(lambda: rig.vesc.state.speed == 0, "standing")
        found = noise(rig, 50_000)
        assert found.alive and found.sent >= 50_000
        bridge_row("R20", "frames beyond the limits, 50,000 bytes of noise at a driving bridge", found.outside, 0)
        bridge_row("R20", "growth of the guard's memory meanwhile", found.growth, 5, "MB")
        rates = steepest_rates(rig.vesc.received, rig.vesc.motor.car)
        # both ends of a window count: 1 + 0.02 / 0.25 times the rate
        bridge_row("R09", "steering on the wire of a whole drive", rates["steering"], 3.2 * 1.08, "rad/s", 1.2)
        bridge_row("R09", "growth of the speed on the wire of a whole drive", rates["speed"], 2.5 * 1.08, "m/s^2", 1.2)
