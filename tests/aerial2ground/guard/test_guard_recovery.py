"""After the emergency stop, a fault or a lost port: what is kept, and what it takes to drive again."""

import pytest

from aerial2ground.guard.faults import Fault
from aerial2ground.guard.states import State
from tests.aerial2ground.guard.bench import ANSWER, BRAKE, CURRENT, FIRMWARE, RPM, SERVO, sent, staged


@pytest.mark.parametrize("stage", ["connected", "ready", "armed", "driving"])
def test_r24_the_emergency_stop(stage, bridge_row):
    bench = staged(stage)
    bench.now += 0.001
    bench.say("estop")
    begun = bench.now
    frames = bench.tick()  # whoever drives the guard calls it at once
    assert bench.fault == "E_STOP"
    if stage in ("armed", "driving"):
        assert frames[0] == (BRAKE, 10_000)
    log = bench.run(1.0)
    bench.say("estop")
    log += bench.run(2.0)
    assert bench.state is State.FAULT and bench.fault == "E_STOP"
    bench.say("stop")
    bench.say("yes")
    bench.hand = True
    log += bench.run(1.0)
    assert bench.state is State.FAULT and bench.fault == "E_STOP"
    bridge_row("R24", f"{stage}: motion after the emergency stop", len(sent(log, RPM)), 0)
    bridge_row(
        "R24", f"{stage}: seconds to the first frame", bench.log[-201][0] - begun if frames == () else 0, 0.05, "s"
    )


def test_r24_only_arming_clears_it(bridge_row):
    bench = staged("driving")
    bench.say("estop")
    bench.say("arm")
    assert bench.guard.notes[-1] == "the car is STOPPING: nothing to arm"
    bench.run(3.0)
    assert bench.state is State.FAULT
    bench.notes.clear()
    bench.arm()
    assert "FAULT -> READY: hold the dead-man within 30 s, and while the car drives" in bench.notes
    bench.drive()
    bridge_row("R24", "does not drive after it was armed anew", bench.car.speed < 0.99 or bench.fault != "", 0)


def test_the_first_fault_is_the_one_that_is_shown():
    bench = staged("driving")
    bench.say("estop")
    bench.say("fault", "LINK_BLOCKED")
    bench.run(5.0)
    bench.say("estop")
    assert bench.fault == "E_STOP"
    assert sum(note.startswith("E_STOP") for note in bench.notes) == 1
    assert not any(note.startswith("LINK_BLOCKED") for note in bench.notes)
    assert bench.notes[-1] == "STOPPING -> FAULT: the car stands"


def test_every_fault_tells_what_to_do():
    for fault in Fault:
        bench = staged("driving")
        bench.say("fault", fault.name)
        assert bench.state is State.STOPPING and bench.fault == fault.name
        assert f"{fault.name}: {fault.value}" in bench.guard.notes
        assert bench.tick()[0] == (BRAKE, 10_000)


def test_r18_a_port_that_goes_and_comes_back_does_not_arm(bridge_row):
    bench = staged("driving")
    bench.now += 0.005
    bench.say("link", "down")
    assert bench.fault == "LINK_LOST"
    assert bench.tick() == ()
    bench.run(1.0)
    bench.say("link", "up")
    log = bench.run(20.0)  # with the hand on the dead-man all the time
    assert bench.state is State.FAULT
    bridge_row("R18", "motion after the port has come back", len(sent(log, RPM)), 0)
    bench.hand = False
    bench.run(1.0)
    bench.say("yes")
    bench.say("arm")
    assert bench.state is State.FAULT
    assert bench.guard.notes[-1] == "not armed; it lacks a look at the wheels (say check, then yes)"
    bench.look_at_wheels().arm()
    assert bench.fault == ""


def test_r18_the_new_controller_proves_itself_anew(bridge_row):
    bench = staged("checked")
    bench.say("link", "down")
    assert bench.guard.firmware is None and bench.guard.probe.seconds is None
    assert "a motor controller on the port" in bench.lacks() and "answers of the motor controller" in bench.lacks()
    bench.say("link", "up")
    bench.car.timeout = 1.0
    bench.run(3.0)
    bench.look_at_wheels()
    bench.run(1.2)
    bench.say("arm")
    assert bench.notes.count("the motor controller stops by itself after 1040 ms of silence") == 1
    bridge_row("R18", "a controller with another timeout is armed", bench.state is not State.FAULT, 0)


def test_r11_a_car_that_rolls_when_the_port_comes_back_is_braked_not_measured(bridge_row):
    bench = staged("driving")
    bench.say("link", "down")
    bench.run(0.1)
    bench.say("link", "up")
    bench.car.told["erpm"] = 3000
    log = bench.run(1.0)
    after = [frames for _, _, frames in log if frames and frames != ((FIRMWARE, 0),)]
    assert bench.state is State.STOPPING and len(after) > 30
    assert not any("own timeout" in note or "timeout of its own" in note for note in bench.notes)
    bench.car.told.clear()
    bench.car.speed = 0.0
    log = bench.run(3.0)
    assert bench.state is State.FAULT and bench.guard.probe.seconds is not None
    bridge_row("R11", "frames that are no brake while it rolls", sum(one[0] != (BRAKE, 10_000) for one in after), 0)


def test_a_port_that_is_opened_once_more_stops_the_car():
    bench = staged("driving")
    bench.say("link", "up")
    assert bench.fault == "LINK_LOST" and bench.state is State.STOPPING
    bench = staged("ready")
    bench.say("link", "up")
    bench.hand = True
    bench.run(1.0)
    assert bench.fault == "" and bench.state is State.DISARMED


def test_a_firmware_of_old_on_a_new_port_gets_no_set_points():
    bench = staged("driving")
    bench.say("link", "down")
    bench.car.firmware = b"\x02\x12\x00"
    bench.say("link", "up")
    log = bench.run(6.0)
    assert {frames for _, _, frames in log} == {(), ((FIRMWARE, 0),)}


def test_after_a_fault_the_car_may_be_rolled_by_hand():
    bench = staged("driving")
    bench.say("estop")
    log = bench.run(3.0)
    assert log[-1][2] == ((CURRENT, 0), (SERVO, 530), (ANSWER, 0))
