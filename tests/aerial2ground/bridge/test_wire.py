"""Numbers from frames, worked by hand."""

import math
import struct

import pytest

from aerial2ground.bridge.wire import (
    SET_CURRENT_REL,
    SET_DUTY,
    SET_POS,
    Received,
    first_brake_after,
    has_alive,
    max_gap,
    motion_frames,
    periods,
    steepest,
    strangers,
)
from aerial2ground.guard.vesc import ALIVE, FW_VERSION, GET_VALUES, SET_BRAKE, SET_CURRENT, SET_RPM, SET_SERVO

SCALE = {SET_RPM: 1, SET_SERVO: 1000, SET_DUTY: 100_000, SET_POS: 1_000_000, SET_CURRENT_REL: 100_000}


def at(time, kind, value=None):
    if value is None:
        return Received(float(time), bytes([kind]))
    layout = ">Bh" if kind == SET_SERVO else ">Bi"
    return Received(float(time), struct.pack(layout, kind, round(value * SCALE.get(kind, 1000))))


def test_values_are_in_physical_units():
    frames = [at(0, SET_RPM, -4614), at(0, SET_BRAKE, 10), at(0, SET_SERVO, 0.53), at(0, SET_DUTY, 0.1)]
    assert [one.value for one in frames] == [-4614, 10, 0.53, 0.1]
    assert math.isnan(at(0, ALIVE).value)
    assert math.isnan(Received(0.0, b"\x08\x00").value), "a number with bytes missing is none"


def test_what_drives_the_motor():
    driving = [at(0, SET_RPM, 1), at(0, SET_RPM, -900), at(0, SET_DUTY, 0.1), at(0, SET_CURRENT, -1)]
    driving += [at(0, SET_POS, 0), at(0, SET_CURRENT_REL, 0.1)]
    resting = [at(0, SET_RPM, 0), at(0, SET_DUTY, 0), at(0, SET_CURRENT, 0), at(0, SET_BRAKE, 10)]
    resting += [at(0, SET_SERVO, 0.9), at(0, GET_VALUES), at(0, FW_VERSION)]
    assert motion_frames(driving + resting) == driving


def test_what_must_never_be_sent():
    fine = [at(0, kind, 0) for kind in (SET_RPM, SET_SERVO, SET_CURRENT, SET_BRAKE)] + [at(0, GET_VALUES)]
    assert not has_alive(fine) and has_alive([*fine, at(0, ALIVE)])
    assert strangers(fine) == [] and [one.kind for one in strangers([*fine, at(0, ALIVE), at(0, SET_POS, 1)])] == [
        30,
        9,
    ]


def test_the_first_brake_is_one_that_lasts():
    frames = [at(0.9, SET_BRAKE, 10), at(1.0, SET_RPM, 4614), at(1.1, SET_BRAKE, 10), at(1.2, SET_RPM, 4614)]
    frames += [at(1.25, SET_RPM, 0), at(1.3, SET_BRAKE, 0), at(1.4, SET_BRAKE, 10), at(1.5, SET_BRAKE, 10)]
    assert first_brake_after(frames, 1.0) == pytest.approx(0.4), "after 1.1 it drove again; 0 A is no brake"
    assert first_brake_after(frames, 1.0, quiet=0.05) == pytest.approx(0.1)
    assert first_brake_after(frames, 1.45) == pytest.approx(0.05)
    assert first_brake_after(frames, 1.6) == math.inf and first_brake_after([], 0.0) == math.inf


def test_periods_and_the_longest_silence():
    frames = [at(0, SET_RPM, 1), at(0.01, SET_SERVO, 0), at(0.5, SET_SERVO, 0), at(0.6, SET_RPM, 1)]
    assert periods(frames) == pytest.approx([0.01, 0.49, 0.1]) and periods(frames, SET_RPM) == pytest.approx([0.6])
    assert max_gap(frames) == pytest.approx(0.49) and max_gap(frames, SET_SERVO) == pytest.approx(0.49)
    assert max_gap([]) == 0.0


def test_a_ramp_shows_its_rate_and_one_period_more():
    # 50 frames a second with 0.02 each are 1 a second; a closed window of 0.25 s holds 13 of them, hence 12 steps:
    # 12 * 0.02 / 0.25 = 0.96
    ramp = [at(0.02 * index, SET_SERVO, 0.02 * index) for index in range(40)]
    assert steepest(ramp, SET_SERVO) == pytest.approx(0.96)
    assert steepest(ramp[:1], SET_SERVO) == 0.0 and steepest([], SET_SERVO) == 0.0


def test_a_jump_is_steep_however_it_is_cut_up():
    # 0.4 at once, or as a burst of 8 within 40 ms: 0.4 / 0.25 s
    jump = [at(0, SET_SERVO, 0.3), at(1, SET_SERVO, 0.3), at(1.02, SET_SERVO, 0.7)]
    burst = [at(0.005 * index, SET_SERVO, 0.3 + 0.05 * index) for index in range(9)]
    assert steepest(jump, SET_SERVO) == pytest.approx(1.6) and steepest(burst, SET_SERVO) == pytest.approx(1.6)


def test_a_change_over_more_than_the_window_is_not_one():
    assert steepest([at(0, SET_SERVO, 0.3), at(0.26, SET_SERVO, 0.7)], SET_SERVO) == 0.0
    # there and back within a window
    there = [at(0, SET_SERVO, 0.5), at(0.1, SET_SERVO, 0.6), at(0.2, SET_SERVO, 0.5)]
    assert steepest(there, SET_SERVO) == pytest.approx(0.4)


def test_braking_is_free_and_a_brake_is_a_speed_of_nothing():
    stop = [at(0, SET_RPM, 4000), at(0.02, SET_BRAKE, 10), at(0.04, SET_BRAKE, 10)]
    assert steepest(stop, SET_RPM, growth=True) == 0.0 and steepest(stop, SET_RPM) == pytest.approx(16_000)
    assert steepest([*stop, at(0.06, SET_RPM, 2000)], SET_RPM, growth=True) == pytest.approx(8000)
    turned = [at(0, SET_RPM, 1000), at(0.02, SET_RPM, -500)]
    assert steepest(turned, SET_RPM, growth=True) == pytest.approx(2000)
