"""Pure pursuit: circles are followed exactly, lines are approached, obstacles slow the car."""

import math

import numpy as np
import pytest

from aerial2ground.car import CarConfig, CarState, advance
from aerial2ground.paths import Path
from aerial2ground.pure_pursuit import LowPass, PurePursuitConfig, near_path, require_followable, speed, steering
from hashnerf.errors import UserError

CONFIG = PurePursuitConfig()
LINE = Path(np.array([(0.0, 0.0), (100.0, 0.0)]))


def circle(radius: float, turns: int = 1) -> Path:
    angle = np.linspace(0, 2 * math.pi * turns, 2001)
    return Path(radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def test_on_a_line_by_hand():
    assert steering(LINE, np.array([5.0, 0.0, 0.0]), CONFIG) == 0.0
    # 0.1 m left of the line: the point is at (0.55, -0.1), curvature 2 * -0.1 / (0.55^2 + 0.1^2) = -0.64
    expected = math.atan(0.33 * -0.2 / 0.3125)
    assert steering(LINE, np.array([5.0, 0.1, 0.0]), CONFIG) == pytest.approx(expected)
    assert steering(LINE, np.array([5.0, 0.0, 0.2]), CONFIG) < 0, "heading left: steer right"


def test_a_circle_is_steered_with_its_curvature():
    for radius in (1.0, 2.0):
        pose = np.array([radius, 0.0, math.pi / 2])
        assert steering(circle(radius), pose, CONFIG) == pytest.approx(math.atan(0.33 / radius), rel=0.01)


def test_the_limit_holds_where_the_path_is_behind():
    assert steering(LINE, np.array([5.0, 0.3, math.pi]), CONFIG) == pytest.approx(CONFIG.steering_limit, abs=1e-9)


def test_a_disturbed_car_comes_back_to_the_path():
    path, car, state = circle(1.5), CarConfig(), CarState(1.6, 0.0, math.pi / 2 + 0.2, 0.8)
    smooth = LowPass(CONFIG.low_pass)
    errors = []
    for _ in range(200):
        state = advance(state, smooth(steering(path, state.pose, CONFIG)), 0.8, 0.05, car)
        errors.append(abs(path.nearest(state.pose[:2])[1]))
    assert max(errors) < 0.2 and max(errors[100:]) < 0.02


def paced(path: Path, pose: tuple[float, float, float], *obstacles: tuple[float, float]) -> float:
    near = near_path(path, np.array(obstacles).reshape(-1, 2), CONFIG)
    return speed(path, np.array(pose), near, CONFIG)


def test_speed_falls_towards_an_obstacle_ahead_and_ignores_others():
    speeds = [paced(LINE, (5.0, 0.0, 0.0), (5.0 + gap, 0.1)) for gap in (2.0, 0.8, 0.6, 0.4, 0.1)]
    assert speeds == pytest.approx([0.8, 0.8, 0.55, 0.3, 0.3])
    assert paced(LINE, (5.0, 0.0, 0.0), (4.0, 0.0), (5.5, 1.0)) == 0.8, "behind, and beside the road"
    assert paced(LINE, (5.0, 0.0, 0.0)) == 0.8
    assert paced(circle(2.0), (2.0, -0.1, math.pi / 2), (2.0, 0.3)) < 0.5, "beyond the seam"


def test_the_low_pass_by_hand():
    smooth = LowPass(0.25)
    assert [smooth(x) for x in (1.0, 0.0, 0.0, 1.0)] == pytest.approx([1.0, 0.75, 0.5625, 0.671875])


def test_a_path_shorter_than_the_look_ahead():
    short = Path(np.array([(0.0, 0.0), (0.3, 0.0)]))
    with pytest.raises(UserError, match=r"0.30 m long, shorter than pure_pursuit.look_ahead = 0.55 m"):
        require_followable(short, CONFIG)
    require_followable(LINE, CONFIG)


@pytest.mark.parametrize(
    "changes", [{"look_ahead": 0.0}, {"low_pass": 0.0}, {"low_pass": 2.0}, {"slow_speed": 3.0}, {"steering_limit": 2.0}]
)
def test_bad_settings_are_named(changes):
    with pytest.raises(UserError, match="pure_pursuit"):
        PurePursuitConfig(**changes)
