"""The set-point's rates and its speed in curves, by hand and over random courses."""

import math
import random

import pytest

from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.set_point import PERIOD, SetPoint
from tests.aerial2ground.guard.bench import CAR


def test_one_period():
    point = SetPoint(CAR)
    point.follow(0.2, 1.0, 0.0)
    assert point.steering == pytest.approx(0.064)  # 3.2 rad/s * 0.02 s
    assert point.speed == pytest.approx(0.05)  # 2.5 m/s^2 * 0.02 s
    point.follow(-0.2, 1.0, PERIOD / 2)
    assert point.steering == pytest.approx(0.032)
    assert point.speed == pytest.approx(0.075)


def test_a_pause_counts_as_one_period():
    point = SetPoint(CAR)
    for now in (0.0, 1.0, 5.0):
        point.follow(0.263, 1.0, now)
    assert point.steering == pytest.approx(3 * 0.064)
    assert point.speed == pytest.approx(0.15)


def test_what_is_near_is_reached_exactly_and_speed_falls_at_once():
    point = SetPoint(CAR)
    point.follow(0.01, 0.02, 0.0)
    assert (point.steering, point.speed) == (0.01, 0.02)
    point.follow(-0.01, 0.0, 1.0)
    assert (point.steering, point.speed) == (-0.01, 0.0)


def test_ramp_down_holds_the_steering_and_ends_at_zero():
    point = SetPoint(CAR)
    point.steering, point.speed = 0.1, 0.08
    speeds = []
    for step in range(3):
        point.ramp_down(step * PERIOD)
        speeds.append(point.speed)
        assert point.steering == 0.1
    assert speeds == [pytest.approx(0.03), 0.0, 0.0]


def test_standing_turns_the_wheels_at_their_rate():
    point = SetPoint(CAR)
    point.steering, point.speed = 0.1, 0.5
    point.stand(0.0, 0.0)
    assert (point.steering, point.speed) == (pytest.approx(0.036), 0.0)
    point.stand(0.0, PERIOD)
    assert (point.steering, point.speed) == (0.0, 0.0)
    point.stand(-0.2, PERIOD + 0.001)
    assert point.steering == pytest.approx(-0.0032)


def test_r10_speed_in_a_curve(bridge_row):
    car = Actuation(speed_limit=2.0)
    point = SetPoint(car)
    for step in range(200):
        point.follow(0.263, 2.0, step * PERIOD)
    # sqrt(3 * 0.325 / tan(0.263)) = sqrt(0.975 / 0.269235) = 1.903 m/s
    assert point.speed == pytest.approx(1.903, abs=1e-3)
    bridge_row("R10", "acceleration across at 0.263 rad", point.speed**2 * math.tan(0.263) / 0.325, 3.0 + 1e-9, "m/s^2")
    assert point.fastest(0.0) == math.inf


@pytest.mark.parametrize("side", [1, -1])
def test_r10_speed_falls_before_the_wheels_have_turned(side, bridge_row):
    car = Actuation(speed_limit=2.0, lateral_acceleration=1.0)
    point, worst = SetPoint(car), 0.0
    for step in range(500):
        wanted = side * 0.263 if 200 <= step < 300 else 0.0
        point.follow(wanted, 2.0, step * PERIOD)
        across = [point.speed**2 * math.tan(abs(angle)) / 0.325 for angle in (wanted, point.steering)]
        worst = max(worst, *across)
    assert point.speed == 2.0  # on the straight that follows
    bridge_row("R10", "acceleration across into, in and out of a curve", worst, 1.0 + 1e-9, "m/s^2")


TIMES = {
    "every 20 ms": lambda chance: 0.02,
    "200 a second": lambda chance: 0.005,
    "jitter": lambda chance: chance.uniform(0.001, 0.06),
    "a pause now and then": lambda chance: 1.0 if chance.random() < 0.02 else 0.02,
    "two at once": lambda chance: chance.choice([0.0, 0.02]),
}


def fastest_change(times, values, window=0.25) -> float:
    """The largest rise in any window, over the window's length."""
    worst, first = 0.0, 0
    for last, now in enumerate(times):
        while now - times[first] > window:
            first += 1
        worst = max(worst, *(values[last] - value for value in values[first : last + 1]))
    return worst / window


@pytest.mark.parametrize("name", list(TIMES))
def test_r09_rates_over_any_window(name, bridge_row):
    chance, point, now = random.Random(3), SetPoint(Actuation(steering_limit=0.263)), 0.0
    times, angles, speeds = [0.0], [0.0], [0.0]
    for step in range(2000):
        now += TIMES[name](chance)
        side = chance.choice([-1, 1]) if name == "jitter" else 1 if step // 30 % 2 else -1
        if step % 50 == 49:
            point.ramp_down(now)
        else:
            point.follow(side * 0.263, chance.choice([0.0, 1.0, 1.0]) if step % 7 == 0 else 1.0, now)
        times.append(now)
        angles.append(point.steering)
        speeds.append(point.speed)
    steering = max(fastest_change(times, angles), fastest_change(times, [-angle for angle in angles]))
    assert max(abs(angle) for angle in angles) <= 0.263
    bridge_row("R09", f"steering stepped from side to side, {name}", steering, 3.2 + 1e-6, "rad/s")
    bridge_row("R09", f"growth of the speed, {name}", fastest_change(times, speeds), 2.5 + 1e-6, "m/s^2")
