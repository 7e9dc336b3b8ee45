"""The inertial sensor on tracks whose rates are known, and the statistics of its errors."""

import math

import numpy as np
import pytest

from hashnerf.errors import UserError
from worlds.inertial import InertialConfig, Readings, measure

PERFECT = {"gyro_noise": 0.0, "gyro_bias": 0.0, "gyro_drift": 0.0, "accel_noise": 0.0, "accel_bias": 0.0}


def readings(time, poses, seed=0, **config) -> Readings:
    return measure(time, poses, InertialConfig(**config), np.random.default_rng(seed))


def standing(seconds: float) -> tuple[np.ndarray, np.ndarray]:
    return np.array([0.0, seconds / 2, seconds]), np.tile([1.0, 2.0, 0.5], (3, 1))


def uneven_times(seconds: float) -> np.ndarray:
    return np.sort(np.concatenate([[0.0, seconds], np.random.default_rng(3).uniform(0, seconds, 400)]))


def circle(time: np.ndarray, radius: float, speed: float) -> np.ndarray:
    """A left turn; the yaw as a compass tells it, in [-pi, pi]."""
    turned = time * speed / radius
    yaw = np.remainder(turned + math.pi, 2 * math.pi) - math.pi
    return np.column_stack([radius * np.sin(turned), radius * (1 - np.cos(turned)), yaw])


def test_n116_a_constant_yaw_rate_is_exact_through_many_turns(numeric_row):
    time = uneven_times(30.0)
    told = readings(time, circle(time, 1.0, 1.0), **PERFECT)
    assert len(told.time) == 3000 and told.time[0] == pytest.approx(0.01) and told.time[-1] == pytest.approx(30.0)
    numeric_row("N116", "a circle at 1 rad/s for 30 s: yaw rate", np.abs(told.yaw_rate - 1.0).max(), 1e-9)


def test_a_constant_acceleration_is_exact_in_the_cars_frame():
    # along +y with the car's nose at 30 degrees to it: 2 m/s^2 are 2 cos 30 forward and 2 sin 30 to the left
    time = uneven_times(3.0)
    poses = np.column_stack([0 * time, 0.3 * time + time**2, np.full_like(time, math.radians(60))])
    told = readings(time, poses, **PERFECT)
    assert np.abs(told.acceleration - [2 * math.cos(math.radians(30)), 2 * math.sin(math.radians(30))]).max() < 1e-6
    assert np.abs(told.yaw_rate).max() < 1e-12


def test_n116_on_a_circle_the_acceleration_points_to_its_centre(numeric_row):
    # 0.8 m/s on a radius of 0.5 m: 1.28 m/s^2 to the left, nothing forward
    time = np.linspace(0.0, 5.0, 2001)
    told = readings(time, circle(time, 0.5, 0.8), **PERFECT)
    inner = slice(2, -2)  # one-sided differences at the ends
    off = np.abs(told.acceleration[inner] - [0.0, 1.28]).max()
    numeric_row("N116", "a left turn of 1.28 m/s^2: forward and left, no gravity", off, 1e-4)


def test_readings_add_up_to_the_turn_and_to_the_change_of_speed():
    time = np.linspace(0.0, 4.0, 1601)
    yaw = np.sin(3 * time)
    speed = 0.5 + 0.2 * np.sin(2 * time)
    step = time[1]
    way = np.stack([speed * np.cos(yaw), speed * np.sin(yaw)], axis=1) * step
    place = np.concatenate([np.zeros((1, 2)), np.cumsum((way[1:] + way[:-1]) / 2, axis=0)])
    told = readings(time, np.column_stack([place, yaw]), **PERFECT)
    assert np.cumsum(told.yaw_rate) / 100 == pytest.approx(np.sin(3 * told.time), abs=1e-9)
    assert np.cumsum(told.acceleration[:, 0]) / 100 == pytest.approx(0.2 * np.sin(2 * told.time), abs=2e-3)


def test_the_last_reading_that_fits_is_the_last():
    time, poses = standing(0.999)
    assert len(readings(time, poses, rate=10.0).time) == 9
    time, poses = standing(1.0)
    assert len(readings(time, poses, rate=10.0).time) == 10
    assert readings(time + 1e9, poses, rate=10.0).time[0] == pytest.approx(1e9 + 0.1, abs=1e-6)


def test_noise_has_the_spread_asked_for_and_no_colour():
    time, poses = standing(400.0)
    told = readings(time, poses, **{**PERFECT, "gyro_noise": 0.02, "accel_noise": 0.3})
    for noise, spread in ((told.yaw_rate, 0.02), *((told.acceleration[:, axis], 0.3) for axis in range(2))):
        # 40,000 readings: the spread is known to 0.35 %, the mean and the correlation to 0.5 % of it
        assert noise.std() == pytest.approx(spread, rel=0.015) and abs(noise.mean()) < 0.02 * spread
        assert abs(np.mean(noise[1:] * noise[:-1])) < 0.02 * spread**2
    assert abs(np.corrcoef(told.acceleration.T)[0, 1]) < 0.02


def test_biases_are_constant_and_drawn_at_each_start():
    time, poses = standing(1.0)
    starts = [readings(time, poses, seed, **{**PERFECT, "gyro_bias": 0.1, "accel_bias": 0.5}) for seed in range(400)]
    assert all(np.ptp(told.yaw_rate) < 1e-12 and np.ptp(told.acceleration, axis=0).max() < 1e-12 for told in starts)
    assert np.std([told.yaw_rate[0] for told in starts]) == pytest.approx(0.1, rel=0.12)
    assert np.std([told.acceleration[0] for told in starts], axis=0) == pytest.approx([0.5, 0.5], rel=0.12)
    assert abs(np.corrcoef([told.acceleration[0] for told in starts], rowvar=False)[0, 1]) < 0.2


def test_the_drift_grows_with_the_root_of_time():
    time, poses = standing(16.0)
    walks = np.array([readings(time, poses, seed, **{**PERFECT, "gyro_drift": 0.1}).yaw_rate for seed in range(400)])
    assert walks[:, 99].std() == pytest.approx(0.1, rel=0.12) and walks[:, 1599].std() == pytest.approx(0.4, rel=0.12)


def test_the_same_seed_gives_the_same_readings():
    time, poses = standing(1.0)
    assert np.array_equal(readings(time, poses, 5).yaw_rate, readings(time, poses, 5).yaw_rate)
    assert not np.array_equal(readings(time, poses, 5).yaw_rate, readings(time, poses, 6).yaw_rate)


@pytest.mark.parametrize(
    ("time", "message"),
    [
        ([0.0, 1.0], "has 2 poses; give at least 3"),
        ([], "has 0 poses"),
        ([0.0, 1.0, 1.0], "do not rise"),
        ([0.0, 2.0, 1.0], "do not rise"),
        ([0.0, float("nan"), 1.0], "not finite"),
        ([0.0, 0.001, 0.002], r"lasts 0.002 s, less than one reading at inertial.rate = 100.0 Hz"),
    ],
)
def test_tracks_that_cannot_be_measured(time, message):
    with pytest.raises(UserError, match=message):
        readings(np.array(time, float), np.zeros((len(time), 3)))


def test_a_pose_that_is_not_finite():
    time, poses = standing(1.0)
    poses[1, 2] = np.nan
    with pytest.raises(UserError, match="not finite"):
        readings(time, poses)


@pytest.mark.parametrize("key", ["rate", "gyro_noise", "gyro_bias", "gyro_drift", "accel_noise", "accel_bias"])
@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
def test_settings_out_of_range_are_named(key, value):
    with pytest.raises(UserError, match=f"inertial.{key}"):
        InertialConfig(**{key: value})
