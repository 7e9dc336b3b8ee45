"""Disturbed poses: where they stand and how many stand where none should."""

import math

import numpy as np
import pytest

from aerial2ground.ground_poses import DisturbanceConfig, disturbed_poses, shifted
from aerial2ground.paths import Path
from hashnerf.errors import UserError

LINE = Path(np.array([(0.0, 0.0), (50.0, 0.0)]))


def draw(count=4000, seed=0, **changes):
    return disturbed_poses(LINE, count, DisturbanceConfig(**changes), np.random.default_rng(seed))


def test_most_poses_stray_as_asked_and_some_further():
    car = draw(wrong_side=0.1, near_accident=0.1)
    left, turn = car.poses[:, 1], car.poses[:, 2]
    usual = np.abs(left) < 0.122
    assert np.median(np.abs(left)) < 0.1
    other = (left > 0.35 - 0.25) & (np.abs(left - 0.35) < 0.25)
    assert 0.08 < (left > 0.25).mean() < 0.2 and other.any()
    assert np.degrees(turn[usual].std()) == pytest.approx(8.0, rel=0.15)
    assert car.tilt.std(axis=0) == pytest.approx([0.005, math.radians(1.0)], rel=0.05)


def test_by_default_three_in_a_hundred_stand_on_the_other_lane():
    car = draw(lateral=0.01, near_accident=0.0)
    assert (car.poses[:, 1] > 0.25).sum() == 120


def test_places_are_spread_evenly():
    car = draw(100)
    assert (np.diff(car.arc) > 0).all() and np.histogram(car.arc, 10, (0, 50))[0].tolist() == [10] * 10


def test_near_accidents_head_off_the_road():
    car = draw(lateral=0.0, heading=0.0, wrong_side=0.0, near_accident=1.0)
    left, turn = car.poses[:, 1], car.poses[:, 2]
    assert (np.abs(left) >= 0.35 * 0.35 - 1e-9).all() and (np.abs(left) <= 0.35 * 0.6 + 1e-9).all()
    assert (np.sign(left) == np.sign(turn)).all() and (np.abs(np.degrees(turn)) >= 5).all()


def test_without_disturbance_the_path_itself():
    car = draw(50, lateral=0.0, heading=0.0, height=0.0, pitch=0.0, wrong_side=0.0, near_accident=0.0)
    assert not car.poses[:, 1:].any() and not car.tilt.any()
    wrong = draw(50, lateral=0.0, heading=0.0, wrong_side=1.0, near_accident=0.0)
    assert wrong.poses[:, 1] == pytest.approx(0.35)


def test_left_is_left_of_the_heading():
    poses = np.array([[1.0, 1.0, math.pi / 2]])
    assert shifted(poses, np.array([0.5]), np.array([0.1]))[0] == pytest.approx([0.5, 1.0, math.pi / 2 + 0.1])


def test_the_seed_decides():
    assert np.array_equal(draw(seed=1).poses, draw(seed=1).poses)
    assert not np.array_equal(draw(seed=1).poses, draw(seed=2).poses)


@pytest.mark.parametrize("changes", [{"lateral": -1.0}, {"wrong_side": 2.0}, {"wrong_side": 0.6, "near_accident": 0.6}])
def test_bad_settings_are_named(changes):
    with pytest.raises(UserError, match="disturbance"):
        DisturbanceConfig(**changes)
