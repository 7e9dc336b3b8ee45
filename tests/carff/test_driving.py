"""Motion of the closed-loop world, on the embedded intersection (stop line at s = 28.15 m, ego at 8 m/s)."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carff.driving import (
    STANDSTILL,
    Drive,
    DrivingConfig,
    Setup,
    actor_poses,
    advance,
    begin,
    can_stop,
    draw_setup,
    going_is_safe,
    hardest_stop,
    stop_matters,
    stopping_speed,
    touches,
)
from hashnerf.errors import UserError
from worlds.boxes import box_at
from worlds.intersection import IntersectionConfig
from worlds.scenarios import build_world

WORLD = build_world(IntersectionConfig(), 0)
NOMINAL = DrivingConfig(start_jitter=0.0, speed_jitter=0.0)
CONFIG = DrivingConfig()
STOP = WORLD.traffic.stop


def setup(branch: int, config: DrivingConfig = NOMINAL, seed: int = 0) -> Setup:
    rng = np.random.default_rng(seed)
    while (drawn := draw_setup(WORLD, config, rng)).branch != branch:
        pass
    return drawn


def driven(start: Drive, command, config: DrivingConfig = NOMINAL) -> Drive:
    """Drives to the end; `command` says go or stop at every tick."""
    drive = start
    while not drive.over and drive.time < config.longest:
        drive = advance(WORLD, drive, command(drive), config)
    return drive


def test_accelerating_from_rest_by_hand():
    drive = Drive(setup(0), time=0.0, s=5.0, speed=0.0)
    for _ in range(20):  # one second in ticks of 0.05 s
        drive = advance(WORLD, drive, True, NOMINAL)
    # Speeds 0.1, 0.2, ... 2.0 m/s: 0.05 * 0.1 * (1 + ... + 20) = 0.005 * 210 = 1.05 m.
    assert drive.speed == pytest.approx(2.0) and drive.s == pytest.approx(6.05) and drive.time == pytest.approx(1.0)
    for _ in range(200):
        drive = advance(WORLD, drive, True, NOMINAL)
    assert drive.speed == pytest.approx(8.0), "never faster than nominal"


def test_hardest_stop_by_hand():
    # 6 m/s^2 at 0.05 s takes 0.3 m/s a tick. From 0.6: speeds 0.3, 0 -> 0.015 m. From 0.75: 0.45, 0.15, 0 -> 0.03 m.
    assert hardest_stop(0.6, CONFIG) == pytest.approx(0.015)
    assert hardest_stop(0.75, CONFIG) == pytest.approx(0.03)
    assert hardest_stop(0.2, CONFIG) == 0.0
    # For high speeds v^2 / (2 h) - v dt / 2: 64 / 12 - 0.2
    assert hardest_stop(8.0, CONFIG) == pytest.approx(64 / 12 - 0.2, abs=2e-3)


def test_stopping_speed_by_hand():
    # v^2 / 6 + 0.025 v = 1.55 for v = 2.975...: 3 b dt = 0.45 m/s covers 0.0225 + 0.015 + 0.0075 = 0.045 m
    assert stopping_speed(0.045, CONFIG) == pytest.approx(0.45)
    assert stopping_speed(0.0, CONFIG) == stopping_speed(-3.0, CONFIG) == 0.0
    assert stopping_speed(100.0, CONFIG) == pytest.approx(math.sqrt(600), rel=0.01)


@given(room=st.floats(0.0, 40.0), braking=st.floats(1.0, 6.0), tick=st.floats(0.01, 0.2))
def test_comfortable_braking_never_passes_the_line_and_ends_at_it(room, braking, tick):
    config = DrivingConfig(comfortable_braking=braking, tick=tick)
    for _ in range(3_000):
        speed = stopping_speed(room, config)
        if speed < STANDSTILL:
            break
        room -= speed * tick
    assert -1e-6 <= room < 0.02, "within two centimetres of the line, never beyond"


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 1000), stop_from=st.floats(0.0, 25.0))
def test_who_can_stop_and_is_told_to_stands_before_the_line(seed, stop_from):
    drive = begin(setup(0, CONFIG, seed))
    while drive.s < stop_from and can_stop(WORLD, drive, CONFIG):
        drive = advance(WORLD, drive, True, CONFIG)
    if can_stop(WORLD, drive, CONFIG):
        end = driven(drive, lambda moment: False, CONFIG)
        assert end.stood and end.crossed is None and end.speed == 0.0
        assert STOP - 0.02 < end.s <= STOP + 1e-6


def test_a_committed_ego_leaves_the_spot_however_gently_it_accelerates():
    gentle = replace(NOMINAL, acceleration=0.2)  # 0.01 m/s a tick, less than what counts as standing
    drive = Drive(setup(0), time=0.0, s=STOP + 1.0, speed=0.0)
    for _ in range(20):
        drive = advance(WORLD, drive, False, gentle)
    assert drive.speed == pytest.approx(0.2)


def test_past_the_point_of_no_return_the_ego_drives_on():
    start = Drive(setup(0), time=0.0, s=STOP - 3.0, speed=8.0)
    assert not can_stop(WORLD, start, NOMINAL), "8 m/s needs 64 / 12 - 0.2 = 5.1 m"
    assert can_stop(WORLD, replace(start, s=STOP - 5.2), NOMINAL)
    assert not can_stop(WORLD, replace(start, s=STOP + 0.1, speed=0.0), NOMINAL), "it is past the line"
    end = driven(start, lambda moment: False)
    assert end.crossed is not None and not end.stood


def test_always_stopping_never_crosses():
    for branch in (0, 1):
        end = driven(begin(setup(branch)), lambda moment: False)
        assert end.stood and not end.collided and end.crossed is None


def test_always_going_meets_the_truck_of_the_nominal_run_and_nobody_without_it():
    clash = driven(begin(setup(1)), lambda moment: True)
    assert clash.collided and clash.crossed is None and clash.over
    free = driven(begin(setup(0)), lambda moment: True)
    # From s = 11 m to the end of the conflict zone, 40 m: 29 / 8 = 3.63 s, so 3.65 s in ticks.
    assert free.crossed == pytest.approx(3.65) and not free.collided and not free.stood


def test_going_is_safe_exactly_where_going_meets_nobody():
    assert going_is_safe(WORLD, begin(setup(0)), NOMINAL)
    assert not going_is_safe(WORLD, begin(setup(1)), NOMINAL)
    standing = Drive(setup(1), time=0.0, s=STOP, speed=0.0)
    assert not going_is_safe(WORLD, replace(standing, time=0.5), NOMINAL)
    assert going_is_safe(WORLD, replace(standing, time=10.0), NOMINAL), "the truck has passed"


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_the_oracle_never_collides_and_always_crosses(seed):
    drive = begin(draw_setup(WORLD, CONFIG, np.random.default_rng(seed)))
    end = driven(drive, lambda moment: going_is_safe(WORLD, moment, CONFIG), CONFIG)
    assert not end.collided and end.crossed is not None
    assert end.setup.branch == 1 or not end.stood, "nothing to wait for without the truck"


def test_touching_agrees_with_the_boxes_everywhere_around_the_conflict_zone():
    present, contacts = setup(1), 0
    for s in np.arange(31.0, 42.0, 0.25):
        for time in np.arange(1.5, 5.0, 0.1):
            ego = box_at(WORLD.traffic.routes["ego"].pose(s), WORLD.actors["ego"].size)
            truck = box_at(actor_poses(WORLD, present, time)["truck"], WORLD.actors["truck"].size)
            assert touches(WORLD, present, float(s), float(time)) == ego.overlaps(truck)
            contacts += ego.overlaps(truck)
    assert contacts > 100 and not touches(WORLD, setup(0), 36.0, 3.0)


@given(s=st.floats(11.0, 28.0), speed=st.floats(0.0, 8.0))
def test_where_stopping_does_not_matter_yet_stop_and_go_are_the_same(s, speed):
    go = stop = Drive(setup(0), time=0.0, s=s, speed=speed)
    if not stop_matters(WORLD, go, NOMINAL) and can_stop(WORLD, go, NOMINAL):
        for _ in range(NOMINAL.decision_ticks):
            go, stop = advance(WORLD, go, True, NOMINAL), advance(WORLD, stop, False, NOMINAL)
        assert stop.s == pytest.approx(go.s) and stop.speed == pytest.approx(go.speed)


def test_stopping_matters_near_the_line_until_it_is_too_late():
    drive = Drive(setup(0), time=0.0, s=11.0, speed=8.0)
    assert not stop_matters(WORLD, drive, NOMINAL)
    assert stop_matters(WORLD, replace(drive, s=STOP - 8.0), NOMINAL)
    assert not stop_matters(WORLD, replace(drive, s=STOP - 2.0), NOMINAL), "committed"
    assert stop_matters(WORLD, replace(drive, s=STOP, speed=0.0), NOMINAL), "it stands and may go"


def test_setups_differ_within_the_jitter_and_repeat_with_the_seed():
    rng = np.random.default_rng(0)
    drawn = [draw_setup(WORLD, CONFIG, rng) for _ in range(200)]
    again = np.random.default_rng(0)
    assert drawn == [draw_setup(WORLD, CONFIG, again) for _ in range(200)]
    starts = np.array([one.start["ego"] for one in drawn])
    speeds = np.array([one.speed["ego"] for one in drawn])
    assert 9.5 <= starts.min() < 9.7 and 12.3 < starts.max() <= 12.5  # 11 +- 1.5 m
    assert 7.2 <= speeds.min() < 7.3 and 8.7 < speeds.max() <= 8.8  # 8 m/s +- 10 %
    assert all(("truck" in one.start) == (one.branch == 1) for one in drawn)
    assert 60 < sum(one.branch for one in drawn) < 140  # one half of 200, 5.6 standard deviations


def test_other_actors_keep_their_speed():
    present = setup(1)
    here, later = (actor_poses(WORLD, present, time)["truck"] for time in (0.0, 2.0))
    assert math.hypot(later.x - here.x, later.y - here.y) == pytest.approx(2 * present.speed["truck"])
    assert set(actor_poses(WORLD, setup(0), 0.0)) == set()


@pytest.mark.parametrize(
    "values", [{"acceleration": 0.0}, {"tick": -1.0}, {"longest": math.inf}, {"decision_ticks": 0}]
)
def test_settings_are_checked(values):
    with pytest.raises(UserError, match=rf"driving\.{next(iter(values))}"):
        DrivingConfig(**values)
