"""The fake controller's motor and servo: what they do can be worked out by hand."""

import pytest

from aerial2ground.bridge.fake_vesc import FEEDING, Motor
from aerial2ground.bridge.wire import SET_DUTY, SET_HANDBRAKE, SET_POS, Received
from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.vesc import (
    ALIVE,
    FW_VERSION,
    GET_VALUES,
    SET_BRAKE,
    SET_CURRENT,
    SET_RPM,
    FrameParser,
    frame,
    query,
    set_brake,
    set_current,
    set_rpm,
    set_servo,
)

CAR = Actuation()


class Bench:
    """A motor on a bench: commands at times that are told."""

    def __init__(self, timeout=None, brake=10.0):
        self.motor, self.now = Motor(CAR, timeout, brake, 0.0), 0.0

    def send(self, data):
        payload = FrameParser().feed(data, 0.0)[0]
        self.motor.feed(payload, self.now)
        self.motor.obey(Received(self.now, payload))

    def run(self, seconds, data=None, every=0.05):
        end = self.now + seconds
        while self.now < end - 1e-9:
            if data:
                self.send(data)
            self.now = min(end, self.now + every)
            self.motor.advance(self.now)


def at_one_metre_a_second(**settings):
    bench = Bench(**settings)
    bench.run(1.0, set_rpm(4614.0))
    assert bench.motor.speed == pytest.approx(1.0)
    bench.motor.distance = 0.0
    return bench


def test_inertia():
    # 3 m/s^2 to 1 m/s: a third of a second and 1 / (2 * 3) m, then 2/3 s at 1 m/s
    bench = Bench()
    bench.run(0.2, set_rpm(4614.0))
    assert bench.motor.speed == pytest.approx(0.6) and bench.motor.erpm == 2768
    bench.run(0.8, set_rpm(4614.0))
    assert bench.motor.speed == pytest.approx(1.0) and bench.motor.distance == pytest.approx(1 / 6 + 2 / 3)


@pytest.mark.parametrize(
    ("data", "way"),
    [
        (set_rpm(0.0), 1 / 6),  # v^2 / (2 * 3)
        (set_rpm(899.0), 1 / 6),  # too slow a set-point brakes
        (set_brake(10.0), 1 / 6),
        (set_brake(50.0), 1 / 6),  # no brake is stronger than 3 m/s^2
        (set_brake(5.0), 1 / 3),  # 1.5 m/s^2
        (set_brake(0.0), 1 / 0.6),  # 0.3 m/s^2
        (set_current(0.0), 1 / 0.6),
        (frame(bytes([SET_HANDBRAKE]) + (10_000).to_bytes(4, "big")), 1 / 6),
    ],
)
def test_ways_to_a_stop(data, way):
    bench = at_one_metre_a_second()
    bench.run(4.0, data)
    assert bench.motor.speed == 0.0 and bench.motor.distance == pytest.approx(way)


def test_a_resting_motor_does_not_start_below_900():
    bench = Bench()
    bench.run(1.0, set_rpm(899.0))
    assert bench.motor.distance == 0.0
    bench.run(1.0, set_rpm(-900.0))
    assert bench.motor.speed == pytest.approx(-900 / 4614)


def test_a_current_drives():
    bench = Bench()
    bench.run(1.0, set_current(5.0))
    assert bench.motor.speed == pytest.approx(1.5) and bench.motor.distance == pytest.approx(0.75)


@pytest.mark.parametrize(("brake", "way"), [(10.0, 1 / 6), (0.0, 1 / 0.6)])
def test_the_timeout_brakes_or_lets_it_roll(brake, way):
    # the last command came at 0.95; the first look at the clock more than 0.2 s later is at 1.15 or 1.16
    bench = at_one_metre_a_second(timeout=0.2, brake=brake)
    assert not bench.motor.timed_out
    bench.run(4.0)
    assert bench.motor.timed_out
    assert 0.15 + way - 1e-6 <= bench.motor.distance <= 0.17 + way


def test_without_a_timeout_it_drives_on_for_ever():
    bench = at_one_metre_a_second()
    bench.run(60.0)
    assert bench.motor.distance == pytest.approx(60.0) and not bench.motor.timed_out


@pytest.mark.parametrize("kind", [SET_DUTY, SET_CURRENT, SET_BRAKE, SET_RPM, SET_POS, SET_HANDBRAKE])
def test_set_points_feed_the_timeout(kind):
    bench = at_one_metre_a_second(timeout=0.2)
    bench.run(1.0, frame(bytes([kind]) + bytes(4)))
    assert not bench.motor.timed_out and kind in FEEDING


def test_alive_keeps_the_last_command_alive():
    bench = at_one_metre_a_second(timeout=0.2)
    bench.run(5.0, query(ALIVE))
    assert not bench.motor.timed_out and bench.motor.distance == pytest.approx(5.0)


@pytest.mark.parametrize("data", [set_servo(0.5), query(GET_VALUES), query(FW_VERSION), frame(b"\x63")])
def test_steering_and_questions_do_not_feed_it(data):
    bench = at_one_metre_a_second(timeout=0.2)
    bench.run(1.0, data)
    assert bench.motor.timed_out and bench.motor.speed == 0.0


def test_a_command_ends_the_timeout():
    bench = Bench(timeout=0.2)
    bench.run(0.5)
    assert bench.motor.timed_out, "nobody ever commanded anything"
    bench.run(0.2, set_rpm(4614.0))
    assert not bench.motor.timed_out and bench.motor.speed > 0.5


def test_the_servo_turns_at_its_own_pace():
    # positions 0.5 -> 0.3 are (0.3 - 0.5) / -1.2135 = 0.1648 rad to the left: 0.0515 s at 3.2 rad/s
    bench, first = Bench(), (0.5 - 0.5304) / -1.2135
    assert bench.motor.steering == pytest.approx(first)
    bench.send(set_servo(0.3))
    bench.run(0.02)
    assert bench.motor.steering == pytest.approx(first + 0.064)
    bench.run(0.2)
    assert bench.motor.steering == pytest.approx((0.3 - 0.5304) / -1.2135)
    bench.send(set_servo(5.0))
    bench.run(2.0)
    assert bench.motor.steering == pytest.approx((1.0 - 0.5304) / -1.2135), "positions end at 1"


def test_a_motor_can_run_away_and_be_stuck():
    bench = Bench(timeout=0.2)
    bench.motor.speed_factor = 1.5
    bench.run(1.0, set_rpm(4614.0))
    assert bench.motor.speed == pytest.approx(1.5)
    bench.motor.speed_factor = 0.0
    bench.run(1.0, set_rpm(4614.0))
    assert bench.motor.speed == 0.0
    bench.motor.runaway_erpm = 9228.0
    bench.run(1.0, set_brake(10.0))
    assert bench.motor.speed == pytest.approx(2.0)


def test_the_kill_switch_brakes_and_nothing_is_obeyed_any_more():
    bench = at_one_metre_a_second()
    bench.motor.kill_switch = True
    bench.run(1.0)
    assert bench.motor.speed == 0.0 and not bench.motor.timed_out
    bench = at_one_metre_a_second()
    bench.motor.kill_switch = True
    # twice as often as the firmware looks at the switch
    bench.run(1.0, set_rpm(4614.0), every=0.005)
    assert bench.motor.speed == 0.0


def test_the_way_does_not_depend_on_how_time_is_cut():
    ways = []
    for every in (0.001, 0.05):
        bench = at_one_metre_a_second()
        bench.run(0.5, set_brake(10.0), every)
        ways.append(bench.motor.distance)
    assert ways[0] == pytest.approx(ways[1]) == pytest.approx(1 / 6)


# on the wire
