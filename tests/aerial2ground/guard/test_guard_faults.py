"""What goes wrong on the road, and how soon the car brakes: policy, camera, controller, link, computer, operator."""

import math

import pytest

from aerial2ground.guard.faults import Fault
from aerial2ground.guard.states import State
from tests.aerial2ground.guard.bench import (
    BRAKE,
    RPM,
    SERVO,
    Bench,
    first,
    sent,
    staged,
)


def brakes_within(bench: Bench, log, begun: float, fault: str) -> float:
    """Seconds from `begun` to the first brake; asserts that it stays braked, and latched under a name."""
    braked = first(log, BRAKE)
    assert not [time for time, _ in sent(log, RPM) if time > braked]
    assert bench.fault == fault
    assert any(note.startswith(f"{fault}") and Fault[fault].value in note for note in bench.notes)
    assert f"ARMED -> STOPPING: {fault}" in bench.notes
    return braked - begun


def rpm(log) -> list[int]:
    """Set-points of the speed."""
    return [value for _, value in sent(log, RPM)]


def steady(log) -> bool:
    """Whether the steering stays where it is."""
    return len({value for _, value in sent(log, SERVO)}) == 1


# the newest picture of the bench is 30 ms old at its period; stalls are counted from when it was taken


def test_r05_a_camera_that_stalls_for_100_ms_changes_nothing(bridge_row):
    bench = staged("driving")
    bench.camera_lives = False
    log = bench.run(0.1)
    bench.camera_lives = True
    log += bench.run(0.5)
    bridge_row("R05", "a stall of 100 ms: slower set-points", sum(value != 4614 for value in rpm(log)), 0)
    assert len(rpm(log)) == 30


def test_r05_a_camera_that_stalls_for_160_ms_slows_the_car_down(bridge_row):
    bench = staged("driving")
    taken = bench._taken
    bench.camera_lives, bench.steering = False, -0.2
    log = bench.run(0.18)
    slowed = next(time for time, value in sent(log, RPM) if value < 4614)
    assert steady(log[6:])  # it has arrived at -0.2 rad, and is held
    assert rpm(log)[-3:] == [4383, 4153, 3922]  # 231 less in every period
    bench.steering = 0.2
    bench.run(0.02)
    assert steady(bench.log[-2:])
    bench.camera_lives = True
    bench.run(0.5)
    assert rpm(bench.log)[-1] == 4614 and bench.state is State.ARMED
    bridge_row("R05", "age of the picture when the car slows down", slowed - taken, 0.17 + 1e-6, "s")


@pytest.mark.parametrize("seconds", [0.26, 5.0])
def test_r05_a_camera_that_stalls_for_longer_brakes_the_car(seconds, bridge_row):
    bench = staged("driving")
    taken = bench._taken
    bench.camera_lives = False
    log = bench.run(seconds)
    bench.camera_lives = True
    log += bench.run(3.0)
    age = brakes_within(bench, log, taken, "PICTURES_OLD")
    assert bench.state is State.FAULT
    bridge_row("R05", f"a stall of {seconds} s: age of the picture at the first brake", age, 0.27 + 1e-6, "s")


def test_r05_ten_identical_pictures(bridge_row):
    bench = staged("driving")
    picture = bench._picture
    look = bench.look

    def frozen():
        look()
        bench._picture = picture

    bench.look = frozen
    log = bench.run(1.0)
    pictures = sum(time <= first(log, BRAKE) for time, _, _ in log) + 1
    brakes_within(bench, log, 0.0, "PICTURES_FROZEN")
    bridge_row("R05", "pictures alike to the bit until the first brake", pictures, 10)


@pytest.mark.parametrize(
    ("what", "changed"),
    [
        ("picture taken before the last one", {"taken": -0.5}),
        ("picture of a clock an hour ahead", {"taken": 3600.0}),
        ("command of a clock an hour ahead", {"sent": 3600.0}),
        ("all of a clock an hour behind", {"taken": -3600.0, "sent": -3600.0}),
        ("the last command again", {"number": 1}),
    ],
)
def test_r05_times_that_cannot_be(what, changed, bridge_row):
    bench = staged("driving")
    bench.now += 0.02
    numbers = {key: value if key == "number" else bench.now + value for key, value in changed.items()}
    bench.send(0.0, 1.0, **numbers)
    begun = bench.now
    bench.tick()
    wait = brakes_within(bench, bench.log[-1:], begun, "BAD_COMMAND")
    bridge_row("R05", f"{what}: seconds to the brake", wait, 0, "s")


def test_r05_the_guards_own_clock_jumps_an_hour(bridge_row):
    bench = staged("driving")
    bench.now += 3600
    bench.say("held")
    bench.look()
    bench.send(0.0, 1.0)
    begun = bench.now
    bench.tick()
    wait = brakes_within(bench, bench.log[-1:], begun, "GUARD_LATE")
    bridge_row("R05", "clock an hour ahead: seconds to the brake", wait, 0, "s")


@pytest.mark.parametrize("camera", [True, False])
def test_r06_a_policy_that_falls_silent(camera, bridge_row):
    bench = staged("driving")
    last = bench.guard.commands.command.sent
    bench.policy_lives = False
    bench.camera_lives = camera
    log = bench.run(1.0)
    slowed = next(time for time, value in sent(log, RPM) if value < 4614)
    bridge_row("R06", "age of the command when the car slows down", slowed - last, 0.12 + 1e-6, "s")
    age = brakes_within(bench, log, last, "POLICY_SILENT")
    bridge_row("R06", "age of the command at the first brake", age, 0.15, "s")
    assert slowed < first(log, BRAKE)


def test_r06_old_commands_that_come_late_refresh_nothing(bridge_row):
    bench = staged("driving")
    waiting, take = [], bench.guard.take
    bench.guard.take = lambda kind, value, now: waiting.append(value) if kind == "message" else take(kind, value, now)
    bench.run(0.12)
    bench.guard.take = take
    bench.policy_lives = False
    bench.now += 0.06
    for message in waiting:
        bench.say("message", message)
    bench.say("held")
    assert len(waiting) == 6
    last = bench.guard.commands.command.sent
    log = bench.run(0.2)
    bridge_row("R06", "a queue of old commands: age at the brake", first(log, BRAKE) - last, 0.15, "s")


BAD = {
    "nan": (math.nan, 0.5),
    "speed nan": (0.0, math.nan),
    "inf": (math.inf, 0.5),
    "-inf": (0.0, -math.inf),
    "1e9": (1e9, 0.5),
    "speed 1e9": (0.0, 1e9),
    "beyond the limit": (0.2631, 0.5),
    "backwards": (0.0, -0.1),
}


@pytest.mark.parametrize("name", list(BAD))
def test_r07_outputs_that_no_sound_policy_gives(name, bridge_row):
    bench = staged("driving")
    bench.now += 0.02
    bench.events()
    bench.send(*BAD[name])
    begun = bench.now
    bench.tick()
    wait = brakes_within(bench, bench.log[-1:], begun, "BAD_COMMAND")
    kind = "steering" if BAD[name][1] == 0.5 else "speed"
    assert f"BAD_COMMAND ({kind} {BAD[name][kind == 'speed']:.6g}" in "".join(bench.notes)
    bench.run(5.0)  # sound commands follow
    assert bench.state is State.FAULT and bench.fault == "BAD_COMMAND"
    bridge_row("R07", f"{name}: seconds to the brake, in the same cycle", wait, 0, "s")


@pytest.mark.parametrize("message", [b"", b"()", b"(1,2,3)", bytes(44), bytes(45), b"None", b"\x01"])
def test_r07_messages_that_are_no_command(message, bridge_row):
    bench = staged("driving")
    bench.now += 0.02
    bench.guard.on_message(message, bench.now)
    begun = bench.now
    bench.tick()
    wait = brakes_within(bench, bench.log[-1:], begun, "BAD_COMMAND")
    assert f"BAD_COMMAND (a message of {len(message)} bytes that is damaged)" in "".join(bench.notes)
    bridge_row("R07", f"{message!r}: seconds to the brake, in the same cycle", wait, 0, "s")


def test_r16_the_guard_slept_for_two_seconds(bridge_row):
    bench = staged("driving")
    bench.now += 2.0
    bench.events()  # the queue holds fresh commands, answers and signs of the hand
    frames = bench.tick()
    assert bench.fault == "GUARD_LATE"
    bench.run(1.0)
    assert bench.state is State.FAULT
    bridge_row("R16", "motion in the first frame after waking", frames[0] != (BRAKE, 10_000), 0)


@pytest.mark.parametrize(("pause", "late"), [(0.0999, False), (0.1001, True)])
def test_the_guard_may_be_a_tenth_of_a_second_late(pause, late):
    bench = staged("driving")
    bench.now += pause
    bench.events()
    bench.tick()
    assert (bench.fault == "GUARD_LATE") == late


def test_r19_a_controller_that_falls_silent(bridge_row):
    bench = staged("driving")
    bench.car.says.clear()
    bench.car.answers = False
    bench.steering = 0.1
    heard = bench.guard.controller.at
    log = bench.run(1.0)
    slowed = next(time for time, value in sent(log, RPM) if value < 4614)
    bridge_row("R19", "silence of the controller when the car slows down", slowed - heard, 0.32 + 1e-6, "s")
    assert slowed - heard > 0.3
    silent = brakes_within(bench, log, heard, "ESC_SILENT")
    bridge_row("R19", "silence of the controller at the first brake", silent, 0.52 + 1e-6, "s")
    assert first(log, BRAKE) - heard > 0.41  # the speed has fallen to 0 by then, or it is a fault


@pytest.mark.parametrize(
    ("told", "fault", "within"),
    [
        ({"fault": 1}, "ESC_FAULT", 0.04),
        ({"status": 2}, "KILL_SWITCH", 0.04),
        ({"celsius": 80.1}, "ESC_HOT", 0.04),
        ({"volts": 9.4}, "BATTERY", 0.56),
        ({"volts": 13.1}, "BATTERY", 0.56),
    ],
)
def test_r21_what_the_controller_says(told, fault, within, bridge_row):
    bench = staged("driving")
    bench.car.told.update(told)
    begun = bench.now
    log = bench.run(2.0)
    wait = brakes_within(bench, log, begun, fault)
    assert wait > within - 0.05
    bridge_row("R21", f"{told}: seconds to the brake", wait, within + 1e-6, "s")


@pytest.mark.parametrize("erpm", [0, 9300, -4614])
def test_r22_wheels_that_do_not_do_as_told(erpm, bridge_row):
    bench = staged("driving")
    bench.car.told["erpm"] = erpm
    begun = bench.now
    wait = brakes_within(bench, bench.run(2.0), begun, "SPEED_MISMATCH")
    assert wait >= 1.0
    bridge_row("R22", f"{erpm} erpm at 1 m/s: seconds to the brake", wait, 1.06, "s")


@pytest.mark.parametrize(("stage", "state"), [("checked", "DISARMED"), ("ready", "READY")])
def test_r22_a_car_that_moves_unasked(stage, state, bridge_row):
    bench = staged(stage)
    bench.car.told["erpm"] = 1400
    begun = bench.now
    log = bench.run(2.0)
    assert bench.fault == "ROLLING" and bench.state is State.FAULT
    assert any(note.endswith("-> FAULT: ROLLING") for note in bench.notes)
    assert first(log, BRAKE) - begun <= 0.041
    fault = next(time for time, other, _ in log if other is State.FAULT)
    bridge_row("R22", f"moved while {state}: seconds to the fault", fault - begun, 1.06, "s")


def test_a_car_that_is_pushed_slowly_is_no_fault():
    bench = staged("checked")
    bench.car.told["erpm"] = 1300
    bench.run(3.0)
    assert bench.fault == "" and bench.state is State.DISARMED


def test_a_car_that_rolls_out_of_a_stop_is_no_new_fault():
    bench = staged("driving")
    bench.say("stop")
    bench.car.told["erpm"] = 4000
    bench.run(2.0)
    assert bench.fault == "" and bench.state is State.STOPPING
