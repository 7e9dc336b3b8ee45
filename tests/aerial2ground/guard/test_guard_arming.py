"""From the port's opening to ARMED: what is sent before, what is asked for, and what arming needs."""

import itertools
import math
import random

import pytest

from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.guard import Guard, GuardSettings
from aerial2ground.guard.states import State
from tests.aerial2ground.guard.bench import (
    ANSWER,
    BRAKE,
    CAR,
    CURRENT,
    DEFAULTS,
    FIRMWARE,
    RPM,
    SERVO,
    Bench,
    is_motion,
    sent,
    staged,
)


def test_r01_no_motion_before_arming(bridge_row):
    bench = Bench().connect()
    bench.speed, bench.hand = 1.0, True
    bench.run(3.0)
    kinds = {kind for _, _, frames in bench.log for kind, _ in frames}
    assert kinds == {FIRMWARE, ANSWER, CURRENT, BRAKE, SERVO}
    assert {argument for _, argument in sent(bench.log, SERVO)} == {530}
    assert bench.state is State.DISARMED
    moving = sum(is_motion(*frame) for _, _, frames in bench.log for frame in frames)
    bridge_row("R01", "motion frames in 5 s without arming", moving, 0)


def test_the_order_of_the_first_frames():
    bench = Bench()
    bench.run(0.1)
    assert not any(frames for _, _, frames in bench.log)  # no port
    bench.say("link", "up")
    bench.car.answers = False
    log = bench.run(0.4)
    assert [frames for _, _, frames in log if frames] == [((FIRMWARE, 0),)] * 4  # every 100 ms
    times = [time for time, _, frames in log if frames]
    assert all(0.099 < later - earlier < 0.121 for earlier, later in itertools.pairwise(times))
    bench.car.answers = True
    bench.run(0.2)
    assert bench.guard.firmware == (6, 2, "bench")
    assert not any(frames for _, _, frames in bench.run(0.2))  # no policy
    bench.say("message", b"ready".hex())
    log = bench.run(0.2)
    # braked until the wheels are known to stand, then one set-point and nothing but questions
    first = ((BRAKE, 10_000), (SERVO, 530), (ANSWER, 0))
    assert [frames for _, _, frames in log] == [first, ((CURRENT, 0), (ANSWER, 0)), *[((ANSWER, 0),)] * 8]
    bench.run(0.12)
    assert bench.notes == ["the motor controller stops by itself after 240 ms of silence"]
    assert {frames for _, _, frames in bench.run(0.2)} == {((CURRENT, 0), (SERVO, 530), (ANSWER, 0))}


def test_ready_is_no_command():
    bench = Bench()
    assert not bench.guard.policy_ready
    bench.say("message", b"ready".hex())
    assert bench.guard.policy_ready and bench.guard.fault is None
    bench.say("message", b"Ready".hex())
    assert bench.fault == "BAD_COMMAND"


def lacking(change, seconds=0.2) -> tuple[Bench, str]:
    """A bench on which all is well but for one change; what arming says then."""
    bench = staged("checked")
    bench.run(1.5)
    assert bench.lacks() == ""
    change(bench)
    bench.run(seconds)
    bench.say("arm")
    return bench, bench.guard.notes[-1]


def set_to(**told):
    """A change of what the controller says."""
    return lambda bench: bench.car.told.update(told)


def other(name, value):
    """A change of something on the bench."""
    return lambda bench: setattr(bench, name, value)


def new_policy_that_is_fast(bench):
    bench.policy_lives = False
    bench.run(0.04)
    bench.send(speed=0.1)


ALONE = {
    "camera": (other("camera_lives", False), "10 different pictures in the last half second (there were "),
    "policy": (other("policy_lives", False), "fresh commands of the policy"),
    "speed": (new_policy_that_is_fast, "a policy that asks for no speed before the car is armed"),
    "policy not ready": (lambda bench: setattr(bench.guard, "policy_ready", False), "a policy that is loaded"),
    "self-test": (
        lambda bench: bench.guard._failed_tests.append("rates"),
        "a guard that passes its own test of rates",
    ),
    "no controller": (lambda bench: setattr(bench.guard, "firmware", None), "a motor controller on the port"),
    "old firmware": (
        lambda bench: setattr(bench.guard, "firmware", (2, 18, "")),
        "a controller with firmware 3 or newer (it has 2)",
    ),
    "answers": (lambda bench: setattr(bench.car, "answers", False), "answers of the motor controller"),
    "battery low": (set_to(volts=9.4), "a battery of 9.5 to 13 V (it has 9.4)"),
    "battery high": (set_to(volts=13.1), "a battery of 9.5 to 13 V (it has 13.1)"),
    "wheels": (set_to(erpm=100), "wheels that stand (they turn at 100 erpm)"),
    "fault": (set_to(fault=4), "a motor controller without fault (its code is 4)"),
    "hot": (set_to(celsius=80.1), "a controller below 80 degrees (it has 80.1)"),
    "kill switch": (set_to(status=2), "a released kill switch"),
    "timeout not measured": (
        lambda bench: setattr(bench.guard.probe, "seconds", None),
        "a measurement of the controller's own timeout",
    ),
    "timeout too long": (
        lambda bench: setattr(bench.guard.probe, "seconds", 1.0),
        "a controller that brakes by itself within 250 ms of silence (found: 1000 ms",
    ),
    "wheels not looked at": (
        lambda bench: setattr(bench.guard.wheels, "confirmed", False),
        "a look at the wheels (say check, then yes)",
    ),
}


@pytest.mark.parametrize("name", list(ALONE))
def test_r02_each_condition_alone(name, bridge_row):
    change, reason = ALONE[name]
    directly = name in ("policy not ready", "no controller", "old firmware", "timeout not measured")
    bench, said = lacking(change, {"camera": 0.4, "answers": 0.34, "speed": 0.0}.get(name, 0.0 if directly else 0.2))
    assert said.startswith("not armed; it lacks ") and reason in said
    assert name == "camera" or len(list(bench.guard.lacks(bench.now))) == 1  # nothing else is missing
    bridge_row("R02", f"armed in spite of: {name}", bench.state is not State.DISARMED, 0)


def test_everything_that_is_lacking_is_said_at_once():
    bench = Bench()
    bench.say("arm")
    said = bench.guard.notes[0]
    assert said.count("; ") == 7
    for reason in ("motor controller on the port", "policy that is loaded", "fresh commands", "answers", "measurement"):
        assert reason in said


def test_r02_all_conditions_for_a_second(bridge_row):
    bench = staged("checked")
    bench.run(2.0)
    bench.car.told["volts"] = 9.0
    bench.run(0.1)
    bench.car.told.clear()
    bench.run(0.04)
    begun = bench.now
    while bench.state is State.DISARMED:
        bench.run(0.02)
        bench.say("arm")
    waited = bench.now - begun
    assert waited < 1.1
    refusals = [note for note in bench.notes if note.startswith("not armed; all conditions must hold for 1 s, they do")]
    assert refusals and "they do for 0.5: say arm again" in "".join(refusals)
    bridge_row("R02", "armed earlier than 1 s after all was well", max(0.0, 1.0 - waited - 0.021), 0, "s")


def test_arming_takes_the_word_and_the_hand():
    bench = staged("checked")
    bench.hand = True
    bench.run(3.0)
    assert bench.state is State.DISARMED
    bench.hand = False
    bench.say("arm")
    assert bench.guard.notes[-1] == "DISARMED -> READY: hold the dead-man within 30 s, and while the car drives"
    bench.run(0.2)
    assert bench.state is State.READY
    bench.hand = True
    log = bench.run(0.5)
    armed = next(time for time, state, _ in log if state is State.ARMED)
    assert 0.3 <= armed - log[0][0] <= 0.321
    assert bench.notes[-1] == "READY -> ARMED: the dead-man is held"


def test_a_hand_that_was_there_before_does_not_count():
    bench = staged("checked")
    bench.run(1.2)
    bench.hand = True
    bench.run(0.5)
    bench.say("arm")
    bench.run(2.0)
    assert bench.state is State.READY
    bench.hand = False
    bench.run(0.2)
    bench.hand = True
    bench.run(0.5)
    assert bench.state is State.ARMED


def test_a_hand_that_trembles_does_not_count():
    bench = staged("ready")
    for step in range(20):
        bench.hand = step % 2 == 0
        bench.run(0.1 if bench.hand else 0.12)
        assert bench.state is State.READY


def test_ready_ends_by_itself():
    bench = staged("ready")
    bench.run(29.8)
    assert bench.state is State.READY
    bench.run(0.3)
    assert bench.state is State.DISARMED
    assert bench.notes[-1] == "READY -> DISARMED: nobody took the dead-man"


def test_ready_ends_when_something_is_missing():
    bench = staged("ready")
    bench.car.told["volts"] = 9.0
    bench.hand = True
    bench.run(0.1)
    assert bench.state is State.DISARMED
    assert bench.notes[-1] == "READY -> DISARMED: it lacks a battery of 9.5 to 13 V (it has 9)"


def test_ready_ends_by_the_word_stop():
    bench = staged("ready")
    bench.say("stop")
    assert bench.state is State.DISARMED
    bench.run(0.02)
    assert bench.notes[-1] == "READY -> DISARMED: stop"


@pytest.mark.parametrize("stage", ["ready", "armed"])
def test_words_that_do_not_fit(stage):
    bench = staged(stage)
    name = bench.state.value
    bench.say("arm")
    bench.say("check")
    assert bench.guard.notes == [
        f"the car is {name}: nothing to arm",
        f"the car is {name}: say stop before the wheels are tried",
    ]
    assert bench.state.value == name


def test_words_that_are_none():
    bench = staged("checked")
    bench.guard.notes.clear()
    bench.say("go")
    (note,) = bench.guard.notes
    assert note.startswith("'go' is no command; say check, yes, no, arm, stop or quit")
    for word in ("yes", "no"):
        bench = staged("connected")
        bench.guard.notes.clear()
        bench.say(word)
        assert bench.guard.notes == ["say check first, and look at the wheels until they stand straight"]
        assert bench.state is State.DISARMED


def test_other_kinds_of_events_are_refused():
    with pytest.raises(KeyError):
        Guard(CAR, DEFAULTS).take("sound", "", 0.0)


@pytest.mark.parametrize("timeout", [0.2, 1.0, math.inf])
def test_r12_the_controllers_timeout_decides(timeout, bridge_row):
    bench = Bench()
    bench.car.timeout = timeout
    bench.connect().look_at_wheels().run(1.2)
    bench.say("arm")
    sound = timeout < 0.25
    assert (bench.lacks() == "") == sound
    bridge_row("R12", f"timeout of {timeout} s judged wrongly", (bench.state is State.READY) != sound, 0)


def test_r12_a_controller_without_status(bridge_row):
    bench = Bench(status=None).connect().look_at_wheels()
    bench.run(1.2)
    assert "found: none, or not told" in bench.lacks()
    bench.say("arm")
    bridge_row("R12", "armed though the controller does not tell of its timeout", bench.state is State.READY, 0)


@pytest.mark.parametrize(("timeout", "accepted"), [(1.0, 1.1), (math.inf, math.inf)])
def test_r12_accepted_by_the_operator(timeout, accepted, bridge_row):
    bench = Bench(CAR, GuardSettings(accept_esc_timeout=accepted))
    bench.car.timeout = timeout
    bench.connect().look_at_wheels().arm()
    loud = [note for note in bench.notes if "ACCEPTED BY THE OPERATOR" in note]
    bridge_row("R12", "longer timeouts that are accepted silently", len(loud) != 1, 0)


def test_the_defaults_accept_nothing_and_end_a_drive_after_ten_minutes():
    assert (DEFAULTS.accept_esc_timeout, DEFAULTS.time_limit) == (0.0, 600.0)


@pytest.mark.parametrize("gain", [-1.2135, 1.2135])
def test_r32_the_servos_way_of_the_wheel_check(gain, bridge_row):
    bench = Bench(Actuation(servo_gain=gain)).connect()
    bench.say("check")
    log = bench.run(1.6)
    positions = [position for _, position in sent(log, SERVO)]
    # half the limit is 0.1315 rad: 0.5304 -+ 1.2135 * 0.1315 = 0.371 and 0.690
    left, right = (371, 690) if gain < 0 else (690, 371)
    assert positions[4:33] == [left] * 29  # 0.1315 rad at 3.2 rad/s take 3 periods
    assert positions[42:68] == [right] * 26
    assert positions[-3:] == [530] * 3
    bench.say("yes")
    assert bench.guard.wheels.confirmed
    wrong = not (positions.index(left) < positions.index(right))
    bridge_row("R32", f"the servo does not go left, right, straight with gain {gain}", wrong, 0)


def test_r32_no_makes_it_a_fault(bridge_row):
    bench = staged("connected")
    bench.say("check")
    assert bench.guard.notes == ["the wheels turn left, then right: say yes if they did, no if not"]
    bench.run(1.5)
    bench.say("no")
    bench.run(1.2)
    bench.say("arm")
    assert bench.fault == "WRONG_CALIBRATION"
    assert "servo_gain" in bench.guard.fault.value
    assert "a look at the wheels" in bench.guard.notes[-1]
    bridge_row("R32", "armed though the wheels turned the wrong way", bench.state is not State.FAULT, 0)


def test_r32_yes_before_the_wheels_have_turned_is_not_taken(bridge_row):
    bench = staged("connected")
    bench.say("check")
    bench.run(1.36)
    bench.say("yes")
    early = bench.guard.wheels.confirmed
    bench = Bench()
    bench.say("link", "up")
    bench.run(0.2)
    bench.say("check")  # the policy is not loaded: nothing is sent that could turn them
    bench.run(2.0)
    bench.say("yes")
    bridge_row("R32", "yes is taken before the wheels could turn", early + bench.guard.wheels.confirmed, 0)


def test_wheels_that_are_tried_need_no_second_look():
    bench = staged("driving")
    bench.say("stop")
    bench.run(3.0)
    bench.arm()
    assert bench.state is State.ARMED


def test_the_wheels_are_not_turned_while_the_car_rolls():
    bench = staged("connected")
    bench.car.told["erpm"] = 501
    bench.run(0.1)
    bench.say("check")
    assert {position for _, position in sent(bench.run(1.2), SERVO)} == {530}
    bench.car.told["erpm"] = 500
    assert 530 not in {position for _, position in sent(bench.run(0.2), SERVO)[5:]}


def test_a_disarmed_car_that_is_pushed_is_braked():
    bench = staged("connected")
    bench.car.told["erpm"] = -150
    assert set(bench.run(0.2)[-1][2]) == {(BRAKE, 10_000), (SERVO, 530), (ANSWER, 0)}
    bench.car.told["erpm"] = 90
    assert set(bench.run(0.2)[-1][2]) == {(CURRENT, 0), (SERVO, 530), (ANSWER, 0)}


def test_firmware_that_is_too_old_is_only_asked_for_its_version():
    bench = Bench()
    bench.car.firmware = b"\x02\x12\x00"
    bench.connect()
    assert {frames for _, _, frames in bench.log} == {(), ((FIRMWARE, 0),)}
    bench.guard.firmware = (3, 0, "")
    bench.run(1.0)
    assert "firmware" not in bench.lacks()
    assert sent(bench.log, SERVO)


def test_only_the_first_word_on_the_firmware_counts():
    bench = staged("connected")
    bench.say("payload", b"\x00\x05\x00".hex())
    assert bench.guard.firmware == (6, 2, "bench")


def test_random_words_before_the_drive_never_move_the_car():
    chance = random.Random(0)
    bench = staged("checked")
    for _ in range(2000):
        bench.run(0.02)
        bench.say(chance.choice(["arm", "check", "yes", "no", "stop", "held", "released", "estop", ""]) or "hello")
    assert not sent(bench.log, RPM)
