"""The pose filter on whole drives: how much less it errs than the network, and whether it knows."""

import math

import numpy as np
import pytest

from aerial2ground.pose_filter import PoseFilter, PoseFilterConfig
from aerial2ground.pose_tracker import filtered_poses
from worlds.boxes import wrap_angle
from worlds.inertial import InertialConfig, Readings, measure

SPEED, STEP, EVERY = 0.5, 0.02, 5
"""Metres per second; seconds between the poses of a track; poses from picture to picture (10 Hz)."""
NOISE = np.array([0.2, 0.2, math.radians(8)])
PERFECT = InertialConfig(50.0, 0.0, 0.0, 0.0, 0.0, 0.0)
ROUGH = InertialConfig(50.0, 0.001, 0.01, 0.0, 0.01, 0.03)


def config(**changes) -> PoseFilterConfig:
    return PoseFilterConfig(**{"first_speed": SPEED, "first_speed_std": 0.1, **changes})


def track(seconds: float, curvature=None) -> tuple[np.ndarray, np.ndarray]:
    """Times and poses of a car that never slips; without `curvature`, round a rounded rectangle of 16 m."""
    time = np.arange(round(seconds / STEP) + 1) * STEP
    way = (np.arange(10 * (len(time) - 1)) + 0.5) * STEP / 10 * SPEED
    if curvature is None:
        corner = math.pi / 2 * 0.6
        ends = np.cumsum([4.0, corner, 8 - 2 * corner - 4.0, corner] * 2)
        assert ends[-1] == pytest.approx(16.0)
        bend = np.array([0.0, 1 / 0.6] * 4)[np.searchsorted(ends, way % 16.0)]
    else:
        bend = np.full(len(way), curvature)
    turn = bend * STEP / 10 * SPEED
    yaw = np.concatenate([[0.0], np.cumsum(turn)])
    chord = SPEED * STEP / 10 * np.sinc(turn / 2 / math.pi)
    middle = yaw[:-1] + turn / 2
    place = np.cumsum(np.stack([chord * np.cos(middle), chord * np.sin(middle)], axis=1), axis=0)
    poses = np.column_stack([np.concatenate([np.zeros((1, 2)), place]), yaw])[::10]
    poses[:, 2] = [wrap_angle(float(angle)) for angle in poses[:, 2]]
    return time, poses


def difference(poses: np.ndarray, others: np.ndarray) -> np.ndarray:
    off = poses - others
    off[..., 2] = np.arctan2(np.sin(off[..., 2]), np.cos(off[..., 2]))
    return off


def rmse(poses: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Position (m) and yaw (degrees)."""
    off = difference(poses, truth)
    return np.array([np.sqrt(np.mean(off[:, :2] ** 2) * 2), np.degrees(np.sqrt(np.mean(off[:, 2] ** 2)))])


def noisy(truth: np.ndarray, rng: np.random.Generator, correlated: float = 0.0) -> np.ndarray:
    """The network's poses: errors of spread NOISE; those of neighbours correlate."""
    errors = rng.standard_normal(truth.shape)
    for row in range(1, len(errors)):
        errors[row] = correlated * errors[row - 1] + math.sqrt(1 - correlated**2) * errors[row]
    return truth + errors * NOISE


def test_a_circle_at_constant_speed_is_followed_exactly_and_across_pi():
    time, poses = track(40.0, curvature=1.0)  # more than three turns
    told = measure(time, poses, PERFECT, np.random.default_rng(0))
    # the sensor's accelerations come from chords; the car's speed is exactly constant
    told = Readings(told.time, told.yaw_rate, 0 * told.acceleration)
    truth = poses[::EVERY]
    assert np.abs(difference(filtered_poses(told, time[::EVERY], truth, config()), truth)).max() < 1e-9
    blind = np.full_like(truth, np.nan)
    blind[0] = truth[0]
    dead_reckoned = filtered_poses(told, time[::EVERY], blind, config())
    assert np.abs(difference(dead_reckoned, truth)).max() < 1e-9
    assert np.abs(dead_reckoned[:, 2]).max() <= math.pi


def test_noise_falls_far_below_the_networks():
    time, poses = track(48.0)
    truth = poses[::EVERY]
    raw, fused = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        told, seen = measure(time, poses, ROUGH, rng), noisy(truth, rng)
        raw.append(rmse(seen, truth))
        fused.append(rmse(filtered_poses(told, time[::EVERY], seen, config(correlation=1.0)), truth))
    assert np.mean(raw, axis=0) == pytest.approx([0.283, 8.0], rel=0.05)
    assert (np.mean(fused, axis=0) < np.mean(raw, axis=0) / [3, 4]).all()


def consistency(correlated: float, runs: int, seconds: float, **changes) -> np.ndarray:
    """Mean squared error of the last pose in units of the filter's own covariance; 3 where that is right."""
    time, poses = track(seconds)
    truth, found = poses[::EVERY], []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        told, seen = measure(time, poses, ROUGH, rng), noisy(truth, rng, correlated)
        speed = SPEED + 0.1 * rng.standard_normal()
        tried, following = PoseFilter(config(first_speed=speed, **changes)), 0
        for picture, row in enumerate(seen):
            while following < len(told.time) and following < picture * EVERY:
                tried.predict(float(told.yaw_rate[following]), float(told.acceleration[following, 0]), STEP)
                following += 1
            tried.update(row)
        off = difference(tried.pose, truth[-1])
        found.append(off @ np.linalg.solve(tried.covariance[:3, :3], off))
    return np.array(found)


MATCHED = {
    "slip": 0.0,
    "gyro_drift": 0.0,
    "accel_drift": 0.0,
    "gyro_noise": 0.001 / math.sqrt(50),
    "accel_noise": 0.01 / math.sqrt(50),
    "gyro_bias_std": 0.01,
    "accel_bias_std": 0.03,
    "gate": 1 - 1e-9,
}


def test_n115_the_filter_knows_its_own_error(numeric_row):
    # the mean of 100 values of chi-square with 3 degrees of freedom: 99 % of them lie in 2.41 to 3.68
    found = consistency(0.0, 100, 8.0, correlation=1.0, **MATCHED).mean()
    numeric_row("N115", "100 drives: mean of the squared error in its own units, off 3", abs(found - 3), 0.59)


def test_errors_alike_from_picture_to_picture_need_the_correlation():
    sure = consistency(0.6, 30, 8.0, correlation=1.0, **MATCHED).mean()
    honest = consistency(0.6, 30, 8.0, correlation=4.0, **MATCHED).mean()
    assert sure > 6 and 1.8 < honest < 4.5


def test_every_tenth_pose_2_m_off_is_refused():
    time, poses = track(32.0)
    truth = poses[::EVERY]
    rng = np.random.default_rng(1)
    told, seen = measure(time, poses, ROUGH, rng), noisy(truth, rng)
    clean = rmse(filtered_poses(told, time[::EVERY], seen, config()), truth)
    angle = rng.uniform(0, 2 * math.pi, len(seen[9::10]))
    seen[9::10, :2] += 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    spoilt = rmse(filtered_poses(told, time[::EVERY], seen, config()), truth)
    assert (spoilt < 1.15 * clean + [0.01, 0.2]).all() and (spoilt < [0.1, 2.0]).all()


def test_the_biases_are_found():
    time, poses = track(64.0)
    truth = poses[::EVERY]
    told = measure(time, poses, PERFECT, np.random.default_rng(0))
    tried = PoseFilter(config(correlation=1.0))
    for picture, row in enumerate(truth):
        if picture:
            for reading in range((picture - 1) * EVERY, picture * EVERY):
                tried.predict(float(told.yaw_rate[reading]) + 0.02, float(told.acceleration[reading, 0]) + 0.1, STEP)
        tried.update(row)
    assert tried.state[3:] == pytest.approx([SPEED, 0.02, 0.1], abs=0.01)


def test_only_what_came_before_a_picture_counts():
    time, poses = track(6.0)
    rng = np.random.default_rng(0)
    told, seen = measure(time, poses, ROUGH, rng), noisy(poses[::EVERY], rng)
    moments = time[::EVERY] + 0.003  # between two readings
    whole = filtered_poses(told, moments, seen, config())
    head = Readings(told.time[:150], told.yaw_rate[:150], told.acceleration[:150])
    assert np.array_equal(filtered_poses(head, moments[:30], seen[:30], config()), whole[:30])


def test_a_picture_between_readings_is_met_by_the_last_one():
    told = Readings(np.array([0.1, 0.2, 0.3]), np.ones(3), np.zeros((3, 2)))
    seen = np.array([[0.0, 0.0, 0.0], [math.nan] * 3, [math.nan] * 3])
    found = filtered_poses(told, np.array([0.05, 0.25, 0.25]), seen, config(first_speed=0.0))
    assert found[:, 2] == pytest.approx([0.0, 0.2, 0.2])


def test_without_readings_the_car_goes_straight_on_and_the_network_leads():
    time, poses = track(10.0)
    nothing = Readings(np.zeros(0), np.zeros(0), np.zeros((0, 2)))
    truth = poses[::EVERY]
    assert rmse(filtered_poses(nothing, time[::EVERY], truth, config()), truth)[0] < 0.2
    assert filtered_poses(nothing, np.zeros(0), np.zeros((0, 3)), config()).shape == (0, 3)


def test_no_pose_is_made_up_before_the_first():
    time, poses = track(1.0)
    told = measure(time, poses, PERFECT, np.random.default_rng(0))
    seen = poses[::EVERY].copy()
    seen[:3] = np.nan
    found = filtered_poses(told, time[::EVERY], seen, config())
    assert np.isnan(found[:3]).all() and np.isfinite(found[3:]).all()


@pytest.mark.parametrize(
    ("times", "moments", "message"),
    [
        ([0.1, 0.1], [0.0, 1.0], "readings must be finite and rise"),
        ([0.1, math.nan], [0.0, 1.0], "readings must be finite and rise"),
        ([0.1, 0.2], [1.0, 0.0], "pictures must be finite and must not fall"),
        ([0.1, 0.2], [0.0, math.inf], "pictures must be finite and must not fall"),
    ],
)
def test_n111_times_out_of_order(numeric_row, times, moments, message):
    told = Readings(np.array(times), np.zeros(2), np.zeros((2, 2)))
    with pytest.raises(ValueError, match=message) as refused:
        filtered_poses(told, np.array(moments), np.zeros((2, 3)), config())
    numeric_row("N111", f"readings at {times}, pictures at {moments} s: taken in", refused is None)
