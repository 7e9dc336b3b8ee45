"""Several ideas of where the car is: the truth wins over bursts of errors, and a car carried away is found."""

import math

import numpy as np
import pytest

from aerial2ground.pose_filter import PoseFilter, PoseFilterConfig
from aerial2ground.pose_tracker import PoseTracker

SPEED = 0.8
CONFIG = PoseFilterConfig(first_speed=SPEED)


def along(tick: int, start: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """A straight drive along x."""
    return np.array([start[0] + SPEED * tick / 10, start[1], 0.0])


def follow(tracker, poses) -> list[np.ndarray]:
    found = []
    for pose in poses:
        tracker.predict(0.0, 0.0, 0.1)
        tracker.update(pose)
        found.append(tracker.pose)
    return found


def test_a_burst_of_errors_at_the_start_is_left_behind():
    wrong = [along(tick, (3.0, 2.0)) + np.array([0.0, 0.02 * tick, 0.3 * (-1) ** tick]) for tick in range(10)]
    right = [along(tick) for tick in range(10, 60)]
    found = follow(PoseTracker(CONFIG), wrong + right)
    # ten pictures agreed with the wrong idea; about as many must agree with the right one
    assert np.linalg.norm((found[25] - right[15])[:2]) < 0.1
    alone = PoseFilter(CONFIG)
    for pose in wrong + right:
        alone.predict(0.0, 0.0, 0.1)
        alone.update(pose)
    assert np.linalg.norm((alone.pose - right[-1])[:2]) > 1.0, "one filter alone refuses what is right for good"


def test_a_long_burst_of_scattered_errors_moves_nothing():
    rng = np.random.default_rng(0)
    tracker = PoseTracker(CONFIG)
    follow(tracker, [along(tick) for tick in range(30)])
    scattered = [np.array([*rng.uniform(-4, 4, 2), rng.uniform(-3, 3)]) + along(tick) for tick in range(30, 60)]
    found = follow(tracker, scattered)
    assert np.linalg.norm((found[-1] - along(59))[:2]) < 0.3
    assert len(tracker.hypotheses) == CONFIG.hypotheses


def test_few_sure_pictures_outweigh_many_unsure_ones():
    tracker = PoseTracker(CONFIG)
    for tick in range(12):
        tracker.predict(0.0, 0.0, 0.1)
        tracker.update(along(tick, (3.0, 2.0)), np.array([0.6, 0.5]))
    for tick in range(12, 17):
        tracker.predict(0.0, 0.0, 0.1)
        tracker.update(along(tick), np.array([0.08, 0.05]))
    assert np.linalg.norm((tracker.pose - along(16))[:2]) < 0.1
    constant = PoseTracker(CONFIG)
    found = follow(constant, [along(tick, (3.0, 2.0)) for tick in range(12)] + [along(tick) for tick in range(12, 17)])
    assert np.linalg.norm((found[-1] - along(16))[:2]) > 2.0, "all equally sure, twelve outweigh five"


def test_a_car_carried_elsewhere_is_found_again():
    tracker = PoseTracker(CONFIG)
    follow(tracker, [along(tick) for tick in range(60)])
    found = follow(tracker, [along(tick, (0.0, 5.0)) for tick in range(60, 110)])
    assert abs(found[-1][1] - 5.0) < 0.05
    # as long as the old idea had more agreement it was told: it fades by 1/30 a picture
    assert abs(found[3][1]) < 0.05


@pytest.mark.parametrize("jump", [(2.0, 0.0), (0.0, 2.0), (0.0, 5.0)])
def test_n113_a_lasting_jump_is_followed(numeric_row, jump):
    tracker = PoseTracker(CONFIG)
    follow(tracker, [along(tick) for tick in range(300)])
    found = follow(tracker, [along(tick, jump) for tick in range(300, 400)])
    there = [np.linalg.norm((pose - along(tick, jump))[:2]) < 0.1 for tick, pose in enumerate(found, 300)]
    assert all(there[there.index(True) :]), "and not left again"
    # as the documentation of the tracker has it: 0.7 of the memory and three pictures
    limit = (0.7 * CONFIG.memory + 3) / 10
    numeric_row(
        "N113", f"{jump} m off for 100 pictures at 10 Hz: seconds until found", (there.index(True) + 1) / 10, limit
    )


def test_n113_a_jump_of_one_picture_moves_nothing(numeric_row):
    tracker = PoseTracker(CONFIG)
    before = follow(tracker, [along(tick) for tick in range(60)])[-1]
    tracker.update(along(59, (0.0, 2.0)))
    numeric_row("N113", "2 m off for one picture: metres moved", np.linalg.norm((tracker.pose - before)[:2]), 0.01)


def test_ideas_that_meet_become_one():
    tracker = PoseTracker(CONFIG)
    follow(tracker, [along(0), along(1) + np.array([1.5, 0.0, 0.0])] + [along(tick) for tick in range(2, 40)])
    assert len(tracker.hypotheses) <= 2
    assert np.linalg.norm((tracker.pose - along(39))[:2]) < 0.05


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_no_idea_begins_with_a_pose_that_is_none(bad):
    tracker = PoseTracker(CONFIG)
    assert not tracker.update(np.array([bad, 0.0, 0.0])) and not tracker.started
    with pytest.raises(ValueError, match="not known"):
        _ = tracker.pose


def test_all_are_lost_in_a_long_gap():
    tracker = PoseTracker(CONFIG)
    follow(tracker, [along(tick) for tick in range(5)])
    tracker.predict(0.0, 0.0, 10.0)
    assert not tracker.started
