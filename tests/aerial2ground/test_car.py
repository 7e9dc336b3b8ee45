"""The bicycle: exact arcs, limits, and a body around the rear axle."""

import math

import numpy as np
import pytest

from aerial2ground.car import CarConfig, CarState, advance, footprint
from hashnerf.errors import UserError

CAR = CarConfig()


def test_straight_on():
    state = advance(CarState(1.0, 2.0, math.pi / 2, 1.0), 0.0, 1.0, 0.5, CAR)
    assert state.pose == pytest.approx([1.0, 2.5, math.pi / 2])


def test_a_full_circle_closes_whatever_the_step():
    angle = 0.3
    radius = CAR.wheelbase / math.tan(angle)
    for steps in (7, 400):
        state = CarState(0.0, 0.0, 0.0, 1.0, angle)
        for _ in range(steps):
            state = advance(state, angle, 1.0, 2 * math.pi * radius / steps, CAR)
        assert state.pose[:2] == pytest.approx([0, 0], abs=1e-9)
    quarter = advance(CarState(0.0, 0.0, 0.0, 1.0, angle), angle, 1.0, math.pi * radius / 2, CAR)
    assert quarter.pose == pytest.approx([radius, radius, math.pi / 2])


def test_actuators_need_time_and_have_ends():
    state = advance(CarState(0.0, 0.0, 0.0), 1.0, 5.0, 0.1, CAR)
    assert state.steering == pytest.approx(0.32) and state.speed == pytest.approx(0.3)
    for _ in range(50):
        state = advance(state, 1.0, 5.0, 0.1, CAR)
    assert state.steering == CAR.steering_limit and state.speed == 5.0
    assert -math.pi <= state.yaw <= math.pi


def test_the_body_reaches_ahead_of_the_rear_axle():
    corners = footprint(np.array([1.0, 2.0, math.pi / 2]), CAR)
    assert corners.min(axis=0) == pytest.approx([0.86, 1.9]) and corners.max(axis=0) == pytest.approx([1.14, 2.4])


@pytest.mark.parametrize("key", ["wheelbase", "width", "steering_rate"])
def test_bad_settings_are_named(key):
    with pytest.raises(UserError, match=f"car.{key}"):
        CarConfig(**{key: 0.0})
