"""The pose filter, call by call: by hand, against finite differences, and with what must be refused."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aerial2ground.pose_filter import LARGEST_DEVIATION, PoseFilter, PoseFilterConfig, moved, transition
from hashnerf.errors import UserError
from worlds.boxes import wrap_angle

SPEED = 0.5
QUIET = {"gyro_noise": 0.0, "accel_noise": 0.0, "gyro_drift": 0.0, "accel_drift": 0.0, "slip": 0.0}


def config(**changes) -> PoseFilterConfig:
    return PoseFilterConfig(**{"first_speed": SPEED, "first_speed_std": 0.1, **changes})


def difference(poses: np.ndarray, others: np.ndarray) -> np.ndarray:
    off = poses - others
    off[..., 2] = np.arctan2(np.sin(off[..., 2]), np.cos(off[..., 2]))
    return off


def running(seconds: float = 3.0, **changes) -> PoseFilter:
    """A filter that has followed a straight drive along x with exact poses; it stands at x = SPEED * seconds."""
    tried = PoseFilter(config(**changes))
    tried.update(np.zeros(3))
    for tick in range(1, round(seconds * 10) + 1):
        tried.predict(0.0, 0.0, 0.1)
        assert tried.update(np.array([SPEED * tick / 10, 0.0, 0.0]))
    return tried


def test_the_first_updates_by_hand():
    tried = PoseFilter(config(**QUIET, position_std=0.3, yaw_std=6.0, correlation=1.0, first_speed_std=0.0, doubt=1.0))
    assert tried.update(np.array([1.0, 2.0, 0.0])) and tried.pose.tolist() == [1.0, 2.0, 0.0]
    # two measurements of equal weight, nothing in between: the mean, and half the variance
    assert tried.update(np.array([1.2, 2.0, 0.1]))
    assert tried.pose == pytest.approx([1.1, 2.0, 0.05])
    assert np.diag(tried.covariance)[:3] == pytest.approx([0.045, 0.045, math.radians(6) ** 2 / 2])
    # four that count as one: the variance of a fifth of the information more
    slow = PoseFilter(config(**QUIET, position_std=0.3, correlation=4.0, doubt=1.0))
    slow.update(np.zeros(3))
    slow.update(np.array([0.5, 0.0, 0.0]))
    assert slow.pose[0] == pytest.approx(0.1) and slow.covariance[0, 0] == pytest.approx(0.09 * 0.8)


def test_one_step_by_hand():
    # a quarter turn to the left at 1 rad/s true rate and pi / 2 m/s: radius pi / 2, from (0, 0, 0) to (r, r, pi / 2)
    state = np.array([0.0, 0.0, 0.0, math.pi / 2, 0.25, 0.0])
    assert moved(state, 1.25, 0.0, math.pi / 2)[:3] == pytest.approx([math.pi / 2, math.pi / 2, math.pi / 2])
    # straight on, 2 m/s and 3 - 1 m/s^2 for 0.5 s: 1.25 m, then 3 m/s
    state = np.array([1.0, 1.0, math.pi / 2, 2.0, 0.0, 1.0])
    assert moved(state, 0.0, 3.0, 0.5) == pytest.approx([1.0, 2.25, math.pi / 2, 3.0, 0.0, 1.0])


@pytest.mark.parametrize("dt", [0.01, 0.1])
def test_noise_grows_with_time_by_hand_however_it_is_cut(dt):
    noises = {"gyro_noise": 0.03, "accel_noise": 0.04, "gyro_drift": 0.0, "accel_drift": 0.0, "slip": 0.02}
    still = {"first_speed": 0.0, "first_speed_std": 0.1, "gyro_bias_std": 0.05, "accel_bias_std": 0.0}
    tried = PoseFilter(config(**noises, **still, position_std=0.1, yaw_std=1.0, doubt=1.0))
    tried.update(np.zeros(3))
    for _ in range(round(1 / dt)):
        tried.predict(0.0, 0.0, dt)
    variance = np.diag(tried.covariance)
    # one second: random walks of 0.03 rad, 0.04 m/s and 0.02 m, and a turn of 0.05 rad by the bias
    assert variance[2:4] == pytest.approx([math.radians(1) ** 2 + 0.03**2 + 0.05**2, 0.1**2 + 0.04**2])
    assert variance[1] == pytest.approx(0.1**2 + 0.02**2)
    # ahead: also 0.1 m by the unknown speed, and the integral of its random walk, 0.04^2 / 3
    assert variance[0] == pytest.approx(0.1**2 + 0.02**2 + 0.1**2 + 0.04**2 / 3, rel=0.01)


def test_the_covariance_is_bounded_and_keeps_its_correlations():
    tried = PoseFilter(config(slip=100.0, gyro_bias_std=0.5))
    tried.update(np.zeros(3))
    for _ in range(200):
        tried.predict(0.0, 0.0, 0.1)
    deviation = np.sqrt(np.diag(tried.covariance))
    assert deviation[:3] == pytest.approx([100.0, 100.0, math.pi])
    correlation = tried.covariance / np.outer(deviation, deviation)
    assert np.abs(correlation).max() <= 1 + 1e-12 and np.linalg.eigvalsh(tried.covariance).min() >= 0
    assert correlation[2, 4] < -0.9, "the gyro's bias is still to blame for the turn"


@pytest.mark.parametrize("turn", [0.0, 1e-9, 5e-4, 0.3, -4.0, 35.0])
def test_the_jacobian_agrees_with_finite_differences(turn):
    state, dt = np.array([3.0, -2.0, 2.5, 0.7, 0.02, -0.1]), 0.05
    reading = turn + state[4]
    slow = np.empty((6, 6))
    for column in range(6):
        off = 1e-5 * np.eye(6)[column]
        slow[:, column] = (moved(state + off, reading, 0.4, dt) - moved(state - off, reading, 0.4, dt)) / 2e-5
    assert transition(state, reading, 0.4, dt) == pytest.approx(slow, abs=1e-9)


def test_a_wrong_first_pose_is_given_up_for_the_ones_that_follow():
    tried = PoseFilter(config(position_std=0.2, doubt=5.0, first_speed=0.0))
    tried.update(np.array([1.5, 0.0, 0.0]))
    assert tried.update(np.zeros(3)) and abs(tried.pose[0]) < 0.3
    trusting = PoseFilter(config(position_std=0.2, doubt=1.0, first_speed=0.0))
    trusting.update(np.array([1.5, 0.0, 0.0]))
    assert not trusting.update(np.zeros(3)) and trusting.pose[0] == 1.5


def test_n114_yaw_differences_are_wrapped(numeric_row):
    tried = PoseFilter(config(correlation=1.0, first_speed=0.0, doubt=1.0))
    tried.update(np.array([0.0, 0.0, 3.13]))
    assert tried.update(np.array([0.0, 0.0, -3.13]))
    # 0.0232 rad apart: half way is pi itself
    off = abs(wrap_angle(float(tried.pose[2]) - math.pi))
    numeric_row("N114", "3.13 corrected by -3.13: off half way, radians", off, 1e-9)
    assert tried.update(np.array([0.0, 0.0, 3.13 + 2e4 * math.pi]))
    assert abs(wrap_angle(float(tried.pose[2]) - math.pi)) < 0.01


def test_a_network_that_says_how_sure_it_is_is_weighed_by_that():
    tried = PoseFilter(config(**QUIET, correlation=1.0, first_speed_std=0.0, doubt=1.0))
    assert tried.update(np.zeros(3), np.array([0.3, 0.1]))
    # nine times the information: nine tenths of the way
    assert tried.update(np.array([0.1, 0.0, 0.02]), np.array([0.1, 0.1]))
    assert tried.pose == pytest.approx([0.09, 0.0, 0.01])
    assert np.diag(tried.covariance)[:3] == pytest.approx([0.009, 0.009, 0.005])
    # an unsure pose is let through where a sure one is refused
    far = np.array([1.0, 0.0, 0.0])
    assert not tried.update(far, np.array([0.1, 0.1])) and tried.update(far, np.array([2.0, 0.1]))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -1.0, 0.0])
@pytest.mark.parametrize("row", [0, 1])
def test_n112_deviations_that_are_none_are_refused_with_their_pose(numeric_row, bad, row):
    tried, deviation = running(), np.full(2, 0.1)
    deviation[row] = bad
    before, covariance = tried.state, tried.covariance
    assert not tried.update(before[:3], deviation) and tried.refused_poses == 1
    assert tried.evidence(before[:3], deviation) == 0.0
    change = np.abs(tried.state - before).max() + np.abs(tried.covariance - covariance).max()
    numeric_row("N112", f"{bad} as the deviation of {('the place', 'the yaw')[row]}: change of the state", change)


@pytest.mark.parametrize("deviation", [1e-300, 1e-9, 1e9, 1e300])
def test_n112_no_deviation_is_too_small_or_too_large(numeric_row, deviation):
    tried = running()
    for tick in range(31, 60):
        tried.predict(0.0, 0.0, 0.1)
        tried.update(np.array([SPEED * tick / 10, 0.0, 0.0]), np.full(2, deviation))
        assert np.isfinite(tried.evidence(tried.pose, np.full(2, deviation)))
    assert np.isfinite(tried.covariance).all()
    below = -np.linalg.eigvalsh(tried.covariance).min()
    numeric_row("N112", f"a deviation of {deviation:g}: eigenvalues below zero", max(below, 0.0), 1e-12)
    assert tried.pose == pytest.approx([SPEED * 5.9, 0.0, 0.0], abs=0.05)


def test_evidence_by_hand():
    tried = PoseFilter(config(doubt=1.0, elsewhere=20.0))
    assert tried.evidence(np.zeros(3), np.array([0.1, 0.2])) == 0.0, "not started"
    tried.update(np.zeros(3), np.array([0.1, 0.2]))
    # here and in the picture a variance of 0.01 each: 0.02, and 0.08 of yaw; no distance
    density = 1 / ((2 * math.pi) ** 1.5 * 0.02 * math.sqrt(0.08))
    assert tried.evidence(np.zeros(3), np.array([0.1, 0.2])) == pytest.approx(math.log(density * 20 * 2 * math.pi))
    aside = tried.evidence(np.array([0.2, 0.0, 0.0]), np.array([0.1, 0.2]))
    assert aside == pytest.approx(math.log(density * 20 * 2 * math.pi) - 0.2**2 / 0.02 / 2)
    assert tried.evidence(np.array([3.0, 0.0, 0.0]), np.array([0.1, 0.2])) == 0.0, "chance explains it better"
    assert tried.evidence(np.zeros(3), np.array([50.0, 3.0])) == 0.0, "a network that is not sure says nothing"


def test_n113_one_outlier_moves_nothing(numeric_row):
    tried = running()
    before, covariance = tried.state, tried.covariance
    for off in ([2.0, 0.0, 0.0], [0.0, -2.0, 0.0], [0.0, 0.0, math.pi]):
        assert not tried.update(before[:3] + off)
    assert np.array_equal(tried.state, before) and np.array_equal(tried.covariance, covariance)
    numeric_row("N113", "one pose 2 m off: metres moved", np.linalg.norm(tried.pose[:2] - before[:2]), 0.01)
    assert tried.refused_poses == 3


def test_what_is_refused_never_moves_the_filter_however_often():
    tried = running()
    before = tried.state
    assert not any(tried.update(before[:3] + np.array([3.0, 0.0, 0.0])) for _ in range(100))
    assert np.array_equal(tried.state, before) and tried.refused_poses == 100


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("row", [0, 1, 2])
def test_n112_poses_that_are_not_finite_never_reach_the_state(numeric_row, bad, row):
    tried = running()
    before, covariance = tried.state, tried.covariance
    pose = np.zeros(3)
    pose[row] = bad
    assert not any(tried.update(pose) for _ in range(30)), "and never move the filter"
    change = np.abs(tried.state - before).max() + np.abs(tried.covariance - covariance).max()
    numeric_row("N112", f"{bad} in {'xy'[row] if row < 2 else 'yaw'}, 30 times: change of the state", change)
    assert tried.refused_poses == 30


@pytest.mark.parametrize(
    "reading", [(math.nan, 0.0), (0.0, math.nan), (math.inf, 0.0), (0.0, -math.inf), (90.0, 0.0), (0.0, 200.0)]
)
def test_n112_n116_readings_that_cannot_be_are_refused_and_make_unsure(numeric_row, reading):
    tried, sound = running(), running()
    for _ in range(10):
        tried.predict(*reading, 0.02)
        sound.predict(0.0, float(sound.state[5]), 0.02)
    assert tried.refused_readings == 10 and sound.refused_readings == 0
    row = "N116" if np.isfinite(reading).all() else "N112"
    numeric_row(
        row, f"10 readings of {reading[0]:g} rad/s and {reading[1]:g} m/s^2: taken in", 10 - tried.refused_readings
    )
    assert tried.state == pytest.approx(sound.state, abs=1e-12), "it goes on as it did"
    # one radian per second that is not known, for 0.2 s
    grown = tried.covariance[2, 2] - sound.covariance[2, 2]
    assert grown == pytest.approx(0.2**2, rel=1e-9)


@pytest.mark.parametrize("dt", [0.0, -0.02, math.nan, -math.inf])
def test_n111_time_that_does_not_pass_changes_nothing(numeric_row, dt):
    tried = running()
    before, covariance = tried.state, tried.covariance
    tried.predict(1.0, 1.0, dt)
    change = np.abs(tried.state - before).max() + np.abs(tried.covariance - covariance).max()
    numeric_row("N111", f"{dt} seconds: change of state and covariance", change)


def test_n111_what_is_known_falls_with_the_length_of_a_gap(numeric_row):
    known = []
    for dt in (1e-12, 1e-9, 0.02, 0.1, 0.5, 1.9, 10.0, 1e6, math.inf):
        tried = running()
        tried.predict(0.0, 0.0, dt)
        assert np.isfinite(tried.covariance).all()
        beyond = max(float(tried.covariance[2, 2]) / math.pi**2 - 1, 0.0)
        numeric_row("N111", f"a gap of {dt:g} s: variance of the yaw beyond pi^2, as a share", beyond, 1e-12)
        known.append(np.trace(tried.covariance[:3, :3]))
        assert tried.started == (dt <= 2.0)
    numeric_row("N111", "gaps from 1e-12 s to infinity: less known after a shorter one", (np.diff(known) < 0).sum())


def test_a_long_gap_loses_the_pose_and_the_next_one_starts_again():
    tried = running()
    for _ in range(30):
        tried.predict(math.nan, 0.0, 0.1)
    assert not tried.started
    with pytest.raises(ValueError, match="not known"):
        _ = tried.pose
    assert tried.update(np.array([50.0, 0.0, 1.0])) and tried.pose.tolist() == [50.0, 0.0, 1.0]


def test_n116_one_degree_a_second_for_90_s_is_a_right_angle(numeric_row):
    tried = PoseFilter(config(first_speed=0.0, first_speed_std=0.0))
    tried.update(np.zeros(3))
    for _ in range(900):
        tried.predict(math.radians(1.0), 0.0, 0.1)
    off = np.abs(tried.pose - [0.0, 0.0, math.pi / 2]).max()
    numeric_row("N116", "1 degree a second for 90 s: off a right angle, radians", off, 1e-9)


@pytest.mark.parametrize("still", [False, True])
def test_n110_the_covariance_stays_sound_without_process_noise(numeric_row, still):
    """(I - K H) P alone loses positive definiteness at once; here R is 1e-12 and nothing is ever forgotten."""
    speed, turn = (0.0, 0.0) if still else (SPEED, 0.5)
    sure = config(
        **QUIET,
        position_std=1e-6,
        yaw_std=math.degrees(1e-6),
        correlation=1.0,
        first_speed=speed,
        first_speed_std=1.0,
        gyro_bias_std=1.0,
        accel_bias_std=1.0,
    )
    tried, truth = PoseFilter(sure), np.array([0.0, 0.0, 0.0, speed, 0.0, 0.0])
    smallest, uneven = math.inf, 0.0
    for tick in range(4000 if still else 20_000):
        tried.update(truth[:3])
        if tick < 100 or tick % 50 == 0:
            smallest = min(smallest, float(np.linalg.eigvalsh(tried.covariance).min()))
            uneven = max(uneven, float(np.abs(tried.covariance - tried.covariance.T).max()))
        tried.predict(turn, 0.0, 0.05)
        truth = moved(truth, turn, 0.0, 0.05)
        truth[2] = wrap_angle(float(truth[2]))
    about = f"{4000 if still else 20_000} poses, R = 1e-12, no process noise, {'standing' if still else 'driving'}"
    numeric_row("N110", f"{about}: eigenvalues below zero", max(-smallest, 0.0), 0.0)
    numeric_row("N110", f"{about}: not symmetric by", uneven, 1e-12)
    assert tried.refused_poses == 0
    assert np.isfinite(tried.state).all() and np.abs(difference(tried.pose, truth[:3])).max() < 1e-5


extreme = st.one_of(st.floats(-3, 3), st.floats(allow_nan=True, allow_infinity=True))


@given(st.lists(st.tuples(extreme, extreme, extreme, st.booleans()), max_size=30))
def test_whatever_comes_in_the_state_is_finite_and_the_covariance_sound(events):
    tried = PoseFilter(config())
    for first, second, third, picture in events:
        if picture:
            tried.update(np.array([first, second, third]))
        else:
            tried.predict(first, second, third)
    covariance = tried.covariance
    assert np.isfinite(tried.state).all() and np.isfinite(covariance).all() and abs(tried.state[2]) <= math.pi
    assert np.array_equal(covariance, covariance.T) and np.linalg.eigvalsh(covariance).min() >= -1e-9
    assert (np.diag(covariance) <= LARGEST_DEVIATION**2 * (1 + 1e-9)).all()


@pytest.mark.parametrize(
    "changes",
    [
        {"position_std": 0.0},
        {"yaw_std": math.nan},
        {"correlation": 0.5},
        {"slip": -1.0},
        {"first_speed": math.inf},
        {"gate": 1.0},
        {"hypotheses": 0},
        {"memory": 0.5},
        {"longest_reading": 3.0},
    ],
)
def test_bad_settings_are_named(changes):
    with pytest.raises(UserError, match=f"pose_filter.{next(iter(changes))}"):
        PoseFilterConfig(**changes)
