"""The limits of commands, pictures and controller: just below, at, and just above each of them."""

import math
import re

import pytest

from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.faults import Fault
from aerial2ground.guard.health import (
    BATTERY_SECONDS,
    COMMAND_OLD,
    COMMAND_SLOW,
    MISMATCH_SECONDS,
    PICTURE_OLD,
    PICTURE_SLOW,
    VALUES_OLD,
    VALUES_SLOW,
    CommandWatch,
    ControllerWatch,
    Since,
)
from aerial2ground.guard.vesc import Values
from tests.aerial2ground.guard.bench import CAR, command

SOUND = Values(0, 11.8, 0, 30.0, 0)


def after(value: float) -> float:
    """The next number."""
    return math.nextafter(value, math.inf)


def test_since():
    since = Since()
    assert since(False, 1.0) == 0.0
    assert since(True, 2.0) == 0.0
    assert since(True, 2.5) == 0.5
    assert since(False, 3.0) == 0.0
    assert since(True, 3.0) == 0.0
    assert since(True, 4.5) == 1.5


def watch(**numbers) -> CommandWatch:
    """A watch that has taken in one command, sent at 0 on a picture taken at 0 unless said otherwise."""
    one = CommandWatch(CAR)
    assert one.accept(command(**{"number": 1, "picture": 1, "taken": 0.0, "sent": 0.0} | numbers), 0.0) == ""
    return one


def test_the_ages_are_those_of_the_requirements():
    assert (COMMAND_SLOW, PICTURE_SLOW, PICTURE_OLD, VALUES_SLOW, VALUES_OLD) == (0.1, 0.15, 0.25, 0.3, 0.5)
    assert COMMAND_OLD + 0.03 <= 0.15  # a period passes before the brake is sent
    assert COMMAND_OLD > COMMAND_SLOW


def test_a_command_grows_old():
    one = watch()
    assert not one.slow(COMMAND_SLOW) and one.slow(after(COMMAND_SLOW))
    assert one.fault(COMMAND_OLD) is None
    assert one.fault(after(COMMAND_OLD)) is Fault.POLICY_SILENT


def test_a_picture_grows_old_though_commands_on_it_come():
    one = watch()
    for number in range(2, 40):
        now = number * 0.01
        assert one.accept(command(number, 1, 0.0, now), now) == ""
        assert one.slow(now) == (now > PICTURE_SLOW)
        assert one.fault(now) is (Fault.PICTURES_OLD if now > PICTURE_OLD else None)


def test_a_picture_is_as_old_as_its_taking_not_its_coming():
    one = watch(taken=-0.2)
    assert one.slow(0.0)
    assert one.fault(0.05) is None
    assert one.fault(0.0501) is Fault.PICTURES_OLD


def test_no_command_is_slow_and_a_fault():
    one = CommandWatch(CAR)
    assert one.slow(0.0) and one.fault(0.0) is Fault.POLICY_SILENT


def repeated(pictures, step=0.01) -> CommandWatch:
    """A watch after pictures, each taken at a time of its own."""
    one = CommandWatch(CAR)
    for number, picture in enumerate(pictures):
        assert one.accept(command(number + 1, picture, number * step, number * step), number * step) == ""
    return one


def test_r05_ten_pictures_that_are_the_same_to_the_bit(bridge_row):
    assert repeated([1, *[2] * 9]).fault(0.09) is None
    frozen = repeated([1, *[2] * 10])
    bridge_row(
        "R05", "ten identical pictures with new times, not stopped", frozen.fault(0.1) is not Fault.PICTURES_FROZEN, 0
    )
    assert repeated([*[2] * 9, 3, *[2] * 9]).fault(0.18) is None


def test_the_same_picture_taken_at_the_same_time_is_one():
    one = watch()
    for number in range(2, 30):
        assert one.accept(command(number, 1, 0.0, 0.0), 0.0) == ""
    assert one.fault(0.0) is None


def test_pictures_that_are_the_same_grow_old():
    one = repeated([1] * 5, step=0.05)  # the newest taken at 0.2, the last new one at 0
    assert one.fault(0.25) is None
    assert one.fault(0.2501) is Fault.PICTURES_OLD


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"steering": after(CAR.steering_limit)}, "steering 0.263 rad, beyond 0.263"),
        ({"steering": -after(CAR.steering_limit)}, "steering -0.263 rad"),
        ({"steering": math.nan}, "steering nan rad"),
        ({"steering": math.inf}, "steering inf rad"),
        ({"speed": after(1.0)}, "speed 1 m/s, not from 0 to 1.0"),
        ({"speed": -5e-324}, "speed -4.94066e-324 m/s"),
        ({"speed": math.nan}, "speed nan m/s"),
        ({"speed": -math.inf}, "speed -inf m/s"),
        ({"speed": 1e9}, r"speed 1e\+09 m/s"),
        ({"sent": after(1.0)}, "^a picture or command from the future$"),
        ({"taken": 0.9, "sent": 0.8}, "^a picture or command from the future$"),
        ({"taken": math.nan}, "^a picture or command from the future$"),
        ({"sent": math.nan}, "^a picture or command from the future$"),
        ({"number": 1}, "out of order"),
        ({"number": 0}, "out of order"),
        ({"taken": -0.001}, "out of order"),
        ({"taken": -0.2, "sent": -0.001}, "out of order"),
        ({"taken": -0.0, "sent": -0.001}, "future|out of order"),
    ],
)
def test_commands_that_no_sound_policy_sends(changed, reason):
    one = watch()
    sound = {"number": 2, "picture": 2, "taken": 0.5, "sent": 0.6, "steering": 0.1, "speed": 0.5}
    wrong = one.accept(command(**sound | changed), 1.0)
    assert re.search(reason, wrong), wrong
    assert one.command.number == 1 and one.command.speed == 0  # the last sound one
    assert one.accept(command(**sound), 1.0) == ""


@pytest.mark.parametrize(
    "changed",
    [
        {"steering": CAR.steering_limit},
        {"steering": -CAR.steering_limit},
        {"speed": 1.0},
        {"speed": 0.0},
        {"speed": -0.0},
        {"sent": 1.0},
        {"taken": 0.6},
        {"taken": 0.0},
        {"taken": 0.0, "sent": 0.0},
        {"number": 2**32 - 1},
    ],
)
def test_commands_at_their_limits(changed):
    sound = {"number": 2, "picture": 2, "taken": 0.5, "sent": 0.6, "steering": 0.1, "speed": 0.5}
    one = watch()
    assert one.accept(command(**sound | changed), 1.0) == ""
    assert one.command.number == changed.get("number", 2)


def test_the_first_command_may_be_of_any_number_and_time():
    assert CommandWatch(CAR).accept(command(0, 1, -5.0, -4.0), 1.0) == ""


@pytest.mark.parametrize("size", [0, 1, 43, 45])
def test_a_damaged_message_is_called_so(size):
    message = (command(1, 1, 0, 0) * 2)[:size]
    assert CommandWatch(CAR).accept(message, 1.0) == f"a message of {size} bytes that is damaged"


def test_pictures_before_arming():
    one = repeated(range(10), step=0.05)  # taken at 0 ... 0.45
    assert list(one.lacks(0.5)) == []
    assert next(one.lacks(after(0.5))) == "10 different pictures in the last half second (there were 9)"
    assert next(repeated(range(9)).lacks(0.1)) == "10 different pictures in the last half second (there were 9)"
    assert (
        next(repeated([*range(9), 8, 8]).lacks(0.1)) == "10 different pictures in the last half second (there were 9)"
    )
    assert list(repeated(range(30)).lacks(0.3)) == []


def test_commands_before_arming():
    one = repeated(range(10))  # the last sent at 0.09
    assert list(one.lacks(0.19)) == []
    assert list(one.lacks(0.191)) == ["fresh commands of the policy"]
    one.accept(command(20, 20, 0.1, 0.1, speed=1e-9), 0.1)
    assert list(one.lacks(0.1)) == ["a policy that asks for no speed before the car is armed"]
    assert list(CommandWatch(CAR).lacks(0.0)) == [
        "10 different pictures in the last half second (there were 0)",
        "fresh commands of the policy",
    ]


def controller(at=0.0, **changed) -> ControllerWatch:
    """A watch that has taken in one answer, sound but for what is changed."""
    one = ControllerWatch(CAR)
    one.accept(Values(**vars(SOUND) | changed), at)
    return one


def test_answers_grow_old():
    one = controller(erpm=4614)
    assert one.age(0.25) == 0.25
    assert one.speed(VALUES_SLOW) == 1.0 and one.speed(after(VALUES_SLOW)) == math.inf
    assert controller().fault(0.0, VALUES_OLD) is None
    assert controller().fault(0.0, after(VALUES_OLD)) is Fault.ESC_SILENT
    assert list(controller().lacks(VALUES_SLOW)) == []
    assert list(controller().lacks(after(VALUES_SLOW))) == ["answers of the motor controller"]


def test_no_answer_at_all():
    one = ControllerWatch(CAR)
    assert one.age(0.0) == one.speed(0.0) == math.inf
    assert one.fault(0.0, 0.0) is Fault.ESC_SILENT
    assert list(one.lacks(0.0)) == ["answers of the motor controller"]
    assert one.still_for(0.0) == 0.0
    assert controller(at=math.inf).values is not None


@pytest.mark.parametrize(
    ("changed", "fault", "sentence"),
    [
        ({"fault": 1}, Fault.ESC_FAULT, "a motor controller without fault (its code is 1)"),
        ({"fault": 255}, Fault.ESC_FAULT, "a motor controller without fault (its code is 255)"),
        ({"status": 2}, Fault.KILL_SWITCH, "a released kill switch"),
        ({"status": 3}, Fault.KILL_SWITCH, "a released kill switch"),
        ({"temperature": 80.1}, Fault.ESC_HOT, "a controller below 80 degrees (it has 80.1)"),
    ],
)
def test_what_the_controller_says_at_once_a_fault(changed, fault, sentence):
    assert controller(**changed).fault(0.0, 0.0) is fault
    assert list(controller(**changed).lacks(0.0)) == [sentence]


@pytest.mark.parametrize("changed", [{"temperature": 80.0}, {"status": 1}, {"status": None}, {"status": 0}])
def test_what_the_controller_may_say(changed):
    assert controller(**changed).fault(0.0, 0.0) is None
    assert list(controller(**changed).lacks(0.0)) == []


@pytest.mark.parametrize(("voltage", "sound"), [(9.5, True), (13.0, True), (9.4, False), (13.1, False), (0.0, False)])
def test_the_battery_is_given_half_a_second(voltage, sound):
    one = controller(voltage=voltage)
    assert one.fault(0.0, 0.0) is None
    assert one.fault(0.0, 0.49) is None
    assert one.fault(0.0, BATTERY_SECONDS) is (None if sound else Fault.BATTERY)
    wanted = [] if sound else [f"a battery of 9.5 to 13 V (it has {voltage:g})"]
    assert list(controller(voltage=voltage).lacks(0.0)) == wanted
    one.accept(SOUND, 0.5)
    assert one.fault(0.0, 0.5) is None
    one.accept(Values(**vars(SOUND) | {"voltage": voltage}), 0.6)
    assert one.fault(0.0, 0.6) is None  # it is counted anew
    assert BATTERY_SECONDS == 0.5


@pytest.mark.parametrize(
    ("erpm", "commanded", "apart"),
    [
        (0, 0.0, False),
        (1384, 0.0, False),  # 0.29996 m/s
        (1385, 0.0, True),  # 0.30017 m/s
        (-1384, 0.0, False),
        (-1385, 0.0, True),
        (7382, 1.0, False),  # 1.59991 m/s; 1 + 0.6 = 1.6 are accepted
        (7383, 1.0, True),  # 1.60013 m/s
        (1846, 1.0, False),  # 0.40009 m/s
        (1845, 1.0, True),  # 0.39987 m/s
    ],
)
def test_r22_the_wheels_do_not_turn_as_they_were_told(erpm, commanded, apart, bridge_row):
    one = ControllerWatch(CAR)
    found = []
    for now in (0.0, 0.5, 0.99, MISMATCH_SECONDS):
        one.accept(Values(**vars(SOUND) | {"erpm": erpm}), now)
        found.append(one.fault(commanded, now))
    assert found == [None, None, None, Fault.SPEED_MISMATCH if apart else None]
    assert MISMATCH_SECONDS == 1.0
    bridge_row("R22", f"{erpm} erpm at {commanded} m/s, judged wrongly", (found[-1] is not None) != apart, 0)


def test_a_worse_fault_hides_none_of_the_timed_ones():
    one = controller(voltage=5.0, fault=3)
    assert one.fault(0.0, 0.0) is Fault.ESC_FAULT
    one.accept(Values(**vars(SOUND) | {"voltage": 5.0}), 0.4)
    assert one.fault(0.0, 0.5) is Fault.BATTERY


def test_wheels_that_stand():
    one = ControllerWatch(CAR)
    for now, erpm in ((0.0, 99), (0.1, -99), (0.2, 0)):
        one.accept(Values(**vars(SOUND) | {"erpm": erpm}), now)
        assert one.still_for(now) == pytest.approx(now)
    for erpm in (101, -101):
        one.accept(Values(**vars(SOUND) | {"erpm": erpm}), 0.3)
        assert one.still_for(0.3) == 0.0
    assert list(controller(erpm=99).lacks(0.0)) == list(controller(erpm=-99).lacks(0.0)) == []
    for erpm in (100, -100):
        assert list(controller(erpm=erpm).lacks(0.0)) == [f"wheels that stand (they turn at {erpm} erpm)"]


def test_what_is_not_known_does_not_stand():
    one = controller()
    assert one.still_for(0.0) == 0.0
    assert one.still_for(0.2) == 0.2
    assert one.still_for(0.31) == 0.0


def test_everything_that_is_missing_is_told_at_once():
    one = controller(erpm=500, voltage=5.0, fault=2, temperature=99.0, status=2)
    assert len(list(one.lacks(0.0))) == 5


def test_another_cars_limits():
    car = Actuation(
        lowest_voltage=6.0, highest_voltage=8.4, highest_temperature=60.0, speed_limit=2.0, steering_limit=0.1
    )
    one = ControllerWatch(car)
    one.accept(Values(0, 11.8, 0, 61.0, 0), 0.0)
    assert list(one.lacks(0.0)) == [
        "a controller below 60 degrees (it has 61)",
        "a battery of 6 to 8.4 V (it has 11.8)",
    ]
    commands = CommandWatch(car)
    assert "beyond 0.1" in commands.accept(command(1, 1, 0, 0, steering=0.11), 0.0)
    assert commands.accept(command(1, 1, 0, 0, speed=2.0), 0.0) == ""


def test_a_difference_of_exactly_what_is_accepted_is_accepted():
    one = ControllerWatch(Actuation(speed_to_erpm_gain=1000.0))
    one.accept(Values(300, 11.8, 0, 30.0, 0), 0.0)  # 0.3 m/s
    assert one.fault(0.0, 0.0) is None
    one.accept(Values(300, 11.8, 0, 30.0, 0), 1.0)
    assert one.fault(0.0, 1.0) is None
