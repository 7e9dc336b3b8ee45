"""Closed loop: the expert stays on the path, a bad policy is put back, and errors are what they should be."""

import math

import numpy as np
import pytest

from aerial2ground.car import CarConfig
from aerial2ground.driving import DriveConfig, drive
from aerial2ground.imitation import expert_policy
from aerial2ground.paths import Path
from aerial2ground.pure_pursuit import PurePursuitConfig
from hashnerf.errors import UserError

ANGLE = np.linspace(0, 2 * math.pi, 721)
CIRCLE = Path(1.5 * np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1))
PURSUIT, CAR = PurePursuitConfig(), CarConfig()


def blind(state):
    return np.zeros((36, 64, 3), np.uint8)


def nothing(corners):
    return False


def run(policy, path=CIRCLE, touches=nothing, seed=0, obstacles=(), **changes):
    rng, standing = np.random.default_rng(seed), np.array(obstacles, float).reshape(-1, 2)
    return drive(policy, blind, touches, standing, path, DriveConfig(**changes), CAR, PURSUIT, rng)


def test_the_expert_drives_two_laps_from_a_disturbed_start():
    result = run(expert_policy(CIRCLE, PURSUIT))
    laps = np.unwrap(np.arctan2(result.track[:, 1], result.track[:, 0]))
    assert laps[-1] - laps[0] == pytest.approx(4 * math.pi, abs=0.3)
    assert result.interventions == 0 and result.position_rmse < 0.03 and result.yaw_rmse < 4


def test_a_policy_that_never_steers_is_put_back_again_and_again():
    result = run(lambda picture, state: 0.0)
    assert result.interventions > 5 and result.position_rmse > 0.05
    assert np.abs(np.linalg.norm(result.put_back, axis=1) - 1.5).min() > 0.175
    assert result.lateral.max() < 0.175 + 0.8 * 0.1


def test_what_is_touched_counts_once_a_moment():
    hits = iter([False] * 10 + [True] * 3 + [False] * 10_000)
    result = run(expert_policy(CIRCLE, PURSUIT), touches=lambda corners: next(hits))
    assert result.interventions == 3
    assert result.put_back_at.tolist() == [10, 11, 12] and result.unbroken == 11


def test_the_motion_up_to_the_first_intervention_is_one_that_a_car_can_make():
    result = run(lambda picture, state: 0.0, motion_ticks=2)
    pace = np.linalg.norm(np.diff(result.motion[:, 1:3], axis=0), axis=1)
    whole = 2 * result.unbroken
    assert pace[:whole].max() < 0.0401, "0.8 m/s for 0.05 s"
    assert pace[whole] > 0.1, "lifted and put back"
    assert 0 < result.unbroken < len(result.lateral)


def test_nobody_intervenes_where_no_error_is_too_large():
    result = run(lambda picture, state: 0.0, intervention=math.inf)
    assert result.interventions == 0 and result.unbroken == len(result.lateral)
    assert result.lateral.max() > 1.0


def test_an_open_path_is_driven_to_its_end():
    line = Path(np.array([(0.0, 0.0), (6.0, 0.0)]))
    result = run(expert_policy(line, PURSUIT), path=line)
    assert result.track[-1, 0] == pytest.approx(6.0, abs=0.12) and result.interventions == 0


def test_the_car_slows_down_beside_an_obstacle():
    line = Path(np.array([(0.0, 0.0), (6.0, 0.0)]))
    result = run(expert_policy(line, PURSUIT), path=line, obstacles=[(3.0, 0.25)])
    pace = np.linalg.norm(np.diff(result.motion[:, 1:3], axis=0), axis=1) / np.diff(result.motion[:, 0])
    close = np.abs(result.motion[1:, 1] - 2.8) < 0.1
    assert pace[close].max() < 0.35 and pace[result.motion[1:, 1] < 2.0].min() > 0.75 and pace[-1] > 0.75


def test_the_motion_is_finer_than_the_pictures_and_ends_with_them():
    result = run(expert_policy(CIRCLE, PURSUIT), laps=1)
    assert len(result.motion) == 4 * len(result.track) + 1
    assert result.motion[4::4, 1:3] == pytest.approx(result.track)
    assert np.diff(result.motion[:, 0]) == pytest.approx(0.025)


def test_starts_differ_with_the_seed():
    policy = expert_policy(CIRCLE, PURSUIT)
    assert run(policy, seed=1).track[0].tolist() == run(policy, seed=1).track[0].tolist()
    assert run(policy, seed=1).track[0].tolist() != run(policy, seed=2).track[0].tolist()


def test_errors_are_root_mean_squares():
    result = run(expert_policy(CIRCLE, PURSUIT), laps=1)
    assert result.position_rmse == pytest.approx(math.sqrt(sum(x * x for x in result.lateral) / len(result.lateral)))


@pytest.mark.parametrize("changes", [{"laps": 0}, {"tick": 0.0}, {"intervention": -1.0}, {"start_lateral": -1.0}])
def test_bad_settings_are_named(changes):
    with pytest.raises(UserError, match="drive"):
        DriveConfig(**changes)
