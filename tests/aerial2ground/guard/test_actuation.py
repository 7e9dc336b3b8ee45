"""What one car's numbers mean, and which numbers are refused."""

import math
import struct

import pytest

from aerial2ground.guard.actuation import FASTEST, Actuation
from hashnerf.errors import UserError

CAR = Actuation()


def test_the_defaults_are_those_of_the_mit_racecar():
    assert CAR.erpm(1.0) == 4614
    assert CAR.speed(4614) == 1.0
    assert CAR.servo(0.0) == 0.5304
    assert CAR.servo(0.1) == pytest.approx(0.40905)  # -1.2135 * 0.1 + 0.5304
    assert (CAR.servo_min, CAR.servo_max, CAR.steering_limit) == (0.15, 0.85, 0.263)
    assert (CAR.steering_rate, CAR.acceleration, CAR.lateral_acceleration) == (3.2, 2.5, 3.0)
    assert (CAR.wheelbase, CAR.speed_limit, CAR.brake_current) == (0.325, 1.0, 10.0)
    assert (CAR.lowest_voltage, CAR.highest_voltage, CAR.highest_temperature) == (9.5, 13.0, 80.0)
    assert FASTEST == 2.0


def test_both_ends_of_the_steering_lie_in_the_servos_range():
    for steering in (-CAR.steering_limit, CAR.steering_limit):
        assert CAR.servo_min <= CAR.servo(steering) <= CAR.servo_max


RANGES = {
    "speed_to_erpm_gain": (100.0, 100_000.0),
    "servo_min": (0.0, 0.5),
    "servo_max": (0.5, 1.0),
    "servo_offset": (0.5304 - 0.0611, 0.5304 + 0.0004),  # so that the steering limit is still reached
    "steering_limit": (0.01, 0.2633),
    "steering_rate": (0.1, 50.0),
    "wheelbase": (0.05, 3.0),
    "speed_limit": (0.05, 2.0),
    "acceleration": (0.1, 20.0),
    "lateral_acceleration": (0.1, 20.0),
    "brake_current": (1.0, 100.0),
    "lowest_voltage": (3.0, 13.0),
    "highest_voltage": (9.5, 60.0),
    "highest_temperature": (30.0, 120.0),
}
SMALL = {"servo_min": {"steering_limit": 0.02}, "servo_max": {"steering_limit": 0.02, "servo_offset": 0.45}}
"""What else is given, so that the limit in question is the only one that matters."""


@pytest.mark.parametrize("key", [key for key in RANGES if key != "servo_offset"])
def test_every_range_from_its_first_to_its_last_number(key):
    other = SMALL.get(key, {})
    for number, direction in zip(RANGES[key], (-math.inf, math.inf)):
        assert getattr(Actuation(**other | {key: number}), key) == number
        if key == "steering_limit" and number > 0.1:
            number += 1e-4  # the servo's range ends here, which is not one number of the file
        if key != "lowest_voltage" or number != 13:
            with pytest.raises(UserError, match=f"^{key} is .*; .*give"):
                Actuation(**other | {key: math.nextafter(number, direction)})


@pytest.mark.parametrize(
    ("key", "hint"),
    [
        ("speed_to_erpm_gain", "4614"),
        ("servo_min", "from 0 to 0.5"),
        ("servo_max", "from 0.5 to 1"),
        ("servo_offset", "from servo_min to servo_max"),
        ("servo_gain", "-1.2135"),
        ("steering_limit", "15 degrees"),
        ("steering_rate", "3.2"),
        ("wheelbase", "0.325"),
        ("speed_limit", "at most 2.0"),
        ("acceleration", "2.5"),
        ("lateral_acceleration", "ISO 11270"),
        ("brake_current", "at least 1"),
        ("lowest_voltage", "three cells: 9.5"),
        ("highest_voltage", "above lowest_voltage"),
        ("highest_temperature", "80"),
    ],
)
def test_a_refusal_names_the_key_and_a_sound_number(key, hint):
    with pytest.raises(UserError, match=f"^{key} is -99.*{hint}"):
        Actuation(**{key: -99.0})


def test_the_battery_may_not_be_full_below_its_empty_voltage():
    with pytest.raises(UserError, match=r"highest_voltage is 9\.4; give volts above lowest_voltage"):
        Actuation(highest_voltage=9.4)


def test_the_offset_must_lie_in_the_servos_range():
    assert Actuation(servo_offset=0.5, servo_max=0.52, steering_limit=0.01).servo_offset == 0.5
    for offset in (0.149, 0.521):
        with pytest.raises(UserError, match="servo_offset is"):
            Actuation(servo_offset=offset, servo_max=0.52, steering_limit=0.01)
    for end in (0.15, 0.52):  # is in the range, yet leaves no room to steer to both sides
        with pytest.raises(UserError, match=r"give at most 0\.0"):
            Actuation(servo_offset=end, servo_max=0.52, steering_limit=0.01)


@pytest.mark.parametrize("gain", [0.1, -0.1, 10.0, -10.0])
def test_the_servos_gain_may_have_either_sign(gain):
    limit = min(0.263, 0.3196 / abs(gain))
    assert Actuation(servo_gain=gain, steering_limit=limit).servo_gain == gain
    wrong = math.nextafter(gain, 0.0) if abs(gain) < 1 else math.nextafter(gain, gain * 2)
    with pytest.raises(UserError, match="servo_gain is"):
        Actuation(servo_gain=wrong, steering_limit=0.02)


@pytest.mark.parametrize(
    ("offset", "room"),
    [(0.5304, 0.263), (0.3, 0.123), (0.8, 0.041)],  # (0.85-0.5304)/1.2135, (0.3-0.15)/1.2135, (0.85-0.8)/1.2135
)
def test_steering_that_the_servo_does_not_reach_to_both_sides(offset, room):
    assert Actuation(servo_offset=offset, steering_limit=room).steering_limit == room
    with pytest.raises(UserError, match=f"not reach to both sides; give at most {room}"):
        Actuation(servo_offset=offset, steering_limit=room + 0.001)


def test_steering_of_exactly_the_servos_room_is_accepted():
    # 0.35 / 0.7 = 0.5 to both sides; floating point may say 0.49999999999999994
    assert Actuation(servo_offset=0.5, servo_gain=0.7, steering_limit=0.5).servo(0.5) == pytest.approx(0.85)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("key", [*RANGES, "servo_gain"])
def test_numbers_that_are_none(key, value):
    with pytest.raises(UserError, match=f"^{key} is {value}; give a finite number"):
        Actuation(**{key: value})


def test_every_set_point_fits_on_the_wire():
    fastest = Actuation(speed_to_erpm_gain=100_000.0, speed_limit=2.0)
    assert struct.pack(">i", round(fastest.erpm(fastest.speed_limit)))


def test_a_battery_of_more_than_60_volts_is_none():
    for key in ("lowest_voltage", "highest_voltage"):
        with pytest.raises(UserError, match=f"^{key} is 60.5; give volts"):
            Actuation(**{"highest_voltage": 60.0, key: 60.5})
