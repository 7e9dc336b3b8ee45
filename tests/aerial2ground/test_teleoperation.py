"""A person's hand: the error of steering has the size asked for, and what is kept is the expert's steering."""

import math

import numpy as np
import pytest

from aerial2ground.car import CarState
from aerial2ground.paths import Path
from aerial2ground.pure_pursuit import PurePursuitConfig, steering
from aerial2ground.teleoperation import TeleoperationConfig, Teleoperator
from hashnerf.errors import UserError

LINE, PURSUIT = Path(np.array([(0.0, 0.0), (100.0, 0.0)])), PurePursuitConfig()
PICTURE = np.zeros((2, 2, 3), np.uint8)


def person(tick: float = 0.1, **settings) -> Teleoperator:
    return Teleoperator(LINE, PURSUIT, TeleoperationConfig(**settings), tick, np.random.default_rng(0))


def test_what_is_kept_is_what_the_expert_would_do():
    one, state = person(hand=0.2), CarState(5.0, 0.1, 0.1)
    steered = [one(PICTURE, state) for _ in range(3)]
    assert one.wanted == [steering(LINE, state.pose, PURSUIT)] * 3
    assert len(set(steered)) == 3 and len(one.pictures) == 3 and one.poses[2] == pytest.approx(state.pose)


@pytest.mark.parametrize("tick", [0.05, 0.25])
def test_the_error_has_its_size_and_its_time_at_any_rate(tick):
    one = person(tick, hand=0.1, hand_seconds=0.5)
    errors = np.array([one(PICTURE, CarState(5.0, 0.0, 0.0)) for _ in range(40_000)])
    assert errors.std() == pytest.approx(0.1, rel=0.05) and abs(errors.mean()) < 0.01
    # after half a second e^-1 of an error is left
    later = round(0.5 / tick)
    assert np.corrcoef(errors[:-later], errors[later:])[0, 1] == pytest.approx(math.exp(-1), abs=0.06)


def test_a_steady_hand_is_the_expert():
    one = person(hand=0.0)
    assert one(PICTURE, CarState(5.0, 0.1, 0.0)) == one.wanted[0]


@pytest.mark.parametrize("changes", [{"laps": 0}, {"hand": -0.1}, {"hand_seconds": 0.0}, {"views": 0}])
def test_bad_settings_are_named(changes):
    with pytest.raises(UserError, match="teleoperation"):
        TeleoperationConfig(**changes)
