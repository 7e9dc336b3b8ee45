"""Pure pursuit: circles are followed exactly, lines are approached, obstacles slow the car."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

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


def steer_for(x: float, y: float, limit: float = 1.5707) -> float:
    """The angle for a point at (x, y) in the frame of a car with axles 0.325 m apart."""
    distance = math.hypot(x, y)
    config = PurePursuitConfig(look_ahead=max(distance, 1e-6), wheelbase=0.325, steering_limit=limit)
    return steering(Path(np.array([(0.0, 0.0), (2 * x, 2 * y)])), np.zeros(3), config)


def test_n96_angles_for_points_by_hand(numeric_row):
    wanted = {(1, 0): 0.0, (1, 0.5): 0.254368, (0.5, 0.5): 0.576375, (0, 1): 0.576375, (1e8, 1): 0.0}
    # by a circle through both points, d = atan(2 L y / l^2); 0.01 m away it is atan(32.5), near a right angle
    wanted[0.01, 0.01] = math.atan(32.5)
    off = max(abs(steer_for(*point) - angle) for point, angle in wanted.items())
    numeric_row("N96", "six points from 0.014 m to 1e8 m away", off, 1e-6)
    numeric_row("N96", "0.014 m away, beyond the limit", abs(steer_for(0.01, 0.01, 0.4)) - 0.4, 0.0)


def test_n96_a_point_at_the_car_itself(numeric_row):
    # round a ring as long as the look-ahead the point to steer for is where the car is
    ring, bad = circle(0.1), 0
    config = PurePursuitConfig(look_ahead=ring.length)
    for aside in (0.0, 1e-160, 1e-30, 1e-12, 1e-6):
        angle = steering(ring, np.array([ring.points[0, 0] + aside, aside, math.pi / 2]), config)
        bad += not abs(angle) <= CONFIG.steering_limit
    numeric_row("N96", "the point at the rear axle, five ways: not finite or beyond the limit", bad)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("row", [0, 1, 2])
def test_n96_a_pose_that_is_not_finite_stops_the_car(numeric_row, bad, row):
    pose = np.zeros(3)
    pose[row] = bad
    with pytest.raises(UserError, match="not finite; stop the car") as refused:
        steering(LINE, pose, CONFIG)
    numeric_row("N96", f"pose with {bad}: steered on", refused is None)


def test_n97_the_limit_holds_where_the_path_is_behind(numeric_row):
    loose = 0
    for aside in (0.3, 1e-9, 0.0, -1e-9, -0.3):
        for turn in (math.pi, -math.pi, math.pi - 1e-9, 2.5):
            loose += abs(steering(LINE, np.array([5.0, aside, turn]), CONFIG)) != CONFIG.steering_limit
    numeric_row("N97", "the path straight behind, 20 poses: less than full lock", loose)
    assert steering(LINE, np.array([5.0, 0.3, math.pi]), CONFIG) == CONFIG.steering_limit
    assert steering(LINE, np.array([5.0, -0.3, math.pi]), CONFIG) == -CONFIG.steering_limit


@pytest.mark.parametrize("aside", [0.0, 1e-9, -1e-9, 0.5])
def test_n97_a_car_that_faces_the_wrong_way_turns_round(numeric_row, aside):
    car, state = CarConfig(), CarState(50.0, aside, math.pi, 0.8)
    for _ in range(200):
        state = advance(state, steering(LINE, state.pose, CONFIG), 0.8, 0.05, car)
    numeric_row("N97", f"facing backwards {aside} m aside: metres from the path after 10 s", abs(state.y), 0.02)
    assert abs(state.yaw) < 0.05


SHAPES = {
    "points twice": Path(np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 0.0), (1.0, 0.0), (4.0, 1.0), (4.0, 1.0)])),
    "u-turn at the end": Path(np.array([(0.0, 0.0), (5.0, 0.0), (5.0, 0.1), (4.5, 0.1)])),
    "there and back": Path(np.array([(0.0, 0.0), (3.0, 0.0), (0.0, 0.0)])),
    "eight": Path(np.array([(0.0, 0.0), (2.0, 2.0), (2.0, 0.0), (0.0, 2.0), (0.0, 0.0)])),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_n98_any_path_is_steered(numeric_row, shape):
    path, bad = SHAPES[shape], 0
    for s in np.linspace(0.0, path.length, 16):
        place = path.at(np.array([s]))[0]
        for off in ((0.0, 0.0), (0.1, -0.1), (50.0, 50.0)):
            for yaw in np.linspace(-math.pi, math.pi, 7):
                pose = np.array([*(place + off), yaw])
                bad += not abs(steering(path, pose, CONFIG)) <= CONFIG.steering_limit
                bad += not 0 <= speed(path, pose, np.zeros(0), CONFIG) <= CONFIG.speed
    numeric_row("N98", f"{shape}, 336 poses up to 70 m away: steering or speed out of bounds", bad)


def test_n98_at_the_end_of_an_open_path_the_car_stops(numeric_row):
    paces = [paced(LINE, (x, y, 0.0)) for x, y in ((100.0, 0.0), (100.0, 0.3), (101.0, 0.0))]
    numeric_row("N98", "at the end and beyond it: metres a second", max(paces), 0.0)
    assert paced(LINE, (99.9, 0.0, 0.0)) == CONFIG.speed and paced(circle(2.0), (2.0, 0.0, 1.0)) == CONFIG.speed


def test_n98_beyond_the_seam_of_a_ring_it_goes_on(numeric_row):
    ring = circle(1.5)
    turns = (2 * math.pi - 1e-3, 2 * math.pi, 2 * math.pi + 1e-3, 1.0)
    angles = [steering(ring, np.array([1.5 * math.cos(t), 1.5 * math.sin(t), t + math.pi / 2]), CONFIG) for t in turns]
    numeric_row("N98", "across the seam of a ring: change of the steering angle", np.ptp(angles), 1e-4)


@given(st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.floats(-1e3, 1e3)))
def test_every_finite_pose_is_steered_within_the_limit(pose):
    assert abs(steering(SHAPES["eight"], np.array(pose), CONFIG)) <= CONFIG.steering_limit


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


def test_n100_the_low_pass_by_hand(numeric_row):
    smooth = LowPass(0.25)
    off = np.array([smooth(x) for x in (1.0, 0.0, 0.0, 1.0)]) - [1.0, 0.75, 0.5625, 0.671875]
    numeric_row("N100", "four commands, from the first one on", np.abs(off).max(), 1e-12)
    # a share of 1 - exp(-tick / time): after one such time 63 % of a step are reached, after three 95 %
    slow = LowPass(-math.expm1(-0.02 / 0.5))
    slow(0.0)
    reached = [slow(1.0) for _ in range(75)]
    numeric_row(
        "N100", "a step, after one and three times the time constant", abs(reached[24] + math.exp(-1) - 1), 1e-6
    )
    numeric_row("N100", "the same after three", abs(reached[74] + math.exp(-3) - 1), 1e-6)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_n100_a_command_that_is_none_is_not_remembered(numeric_row, bad):
    smooth, clean = LowPass(0.25), LowPass(0.25)
    for one in (smooth, clean):
        one(0.2)
    with pytest.raises(UserError, match="is no steering angle; stop the car"):
        smooth(bad)
    numeric_row("N100", f"{bad} between two commands: change of what follows", abs(smooth(0.1) - clean(0.1)))


@given(st.lists(st.floats(-1.5, 1.5), min_size=1, max_size=20), st.floats(1e-3, 1.0))
def test_what_is_smoothed_stays_between_what_came_in(values, share):
    smooth = LowPass(share)
    for number, value in enumerate(values, 1):
        assert min(values[:number]) - 1e-12 <= smooth(value) <= max(values[:number]) + 1e-12


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
