"""What is found out before arming: the guard's own limits, the controller's timeout, the hand, and the wheels."""

import math

import pytest

from aerial2ground.guard import arming
from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.arming import HELD, LONGEST_TIMEOUT, RELEASED, DeadMan, TimeoutProbe, WheelCheck, self_test
from aerial2ground.guard.health import CommandWatch
from aerial2ground.guard.set_point import SetPoint
from aerial2ground.guard.vesc import Values
from tests.aerial2ground.guard.bench import CAR, taken_apart

SILENCE, CLEAR = Values(0, 11.8, 0, 30.0, 1), Values(0, 11.8, 0, 30.0, 0)


@pytest.mark.parametrize(
    "car", [CAR, Actuation(speed_limit=2.0, servo_gain=1.2135, acceleration=20.0, steering_rate=50.0)]
)
def test_r02_a_sound_guard_passes_its_own_test(car, bridge_row):
    bridge_row("R02", "parts of the self-test that fail", len(self_test(car)), 0)


def test_frames_that_are_wrong(monkeypatch):
    monkeypatch.setattr(arming, "set_rpm", lambda erpm: bytes.fromhex("0205080000120607fa04"))
    assert self_test(CAR) == ["frames"]


@pytest.mark.parametrize(
    ("case", "wrong"),
    [
        ("steering nan, speed 0", lambda steering, speed: math.isnan(steering)),
        ("steering 0, speed nan", lambda steering, speed: math.isnan(speed)),
        ("steering 0.26563, speed 0", lambda steering, speed: steering > 0.2655),
        ("steering 0, speed 1.01", lambda steering, speed: speed > 1),
        ("steering 0, speed -0.01", lambda steering, speed: speed < 0),
    ],
)
def test_limits_that_let_something_through(monkeypatch, case, wrong):
    sound = CommandWatch._wrong

    def lets_through(self, command, last, now):
        return "" if wrong(command.steering, command.speed) else sound(self, command, last, now)

    monkeypatch.setattr(CommandWatch, "_wrong", lets_through)
    assert self_test(CAR) == [f"refusal of {case}"]


@pytest.mark.parametrize("key", ["steering", "speed"])
def test_rates_that_are_not_kept(monkeypatch, key):
    sound = SetPoint.follow

    def too_fast(self, steering, speed, now):
        sound(self, steering, speed, now)
        setattr(self, key, getattr(self, key) * 1.001)

    monkeypatch.setattr(SetPoint, "follow", too_fast)
    assert self_test(CAR) == ["rates"]


def probed(answers, accepted=0.0) -> TimeoutProbe:
    """A probe that began at 0 and got answers, (time, values) each."""
    probe = TimeoutProbe(accepted)
    assert probe.frames(0.0) is not None
    for now, values in answers:
        probe.accept(values, now)
    return probe


def test_r12_one_set_point_then_only_questions(bridge_row):
    probe = TimeoutProbe()
    assert taken_apart(b"".join(probe.frames(3.0))) == ((6, 0), (4, 0))
    sent = [taken_apart(b"".join(probe.frames(3 + 0.02 * step))) for step in range(1, 75)]
    assert taken_apart(b"".join(probe.frames(4.5))) == ((4, 0),)
    assert probe.frames(4.501) is None
    assert probe.seconds == math.inf
    assert probe.frames(4.502) is None
    bridge_row("R12", "frames in the silence that would feed the controller's timeout", sent.count(((4, 0),)) - 74, 0)


def test_the_timeout_is_measured():
    probe = probed([(0.02, CLEAR), (0.2, CLEAR), (0.22, SILENCE), (0.3, SILENCE)])
    assert probe.seconds == 0.22
    assert probe.frames(0.24) is None
    probe.accept(CLEAR, 0.3)
    probe.accept(SILENCE, 0.4)
    assert probe.seconds == 0.22
    assert list(probe.lacks()) == []
    assert probe.finding() == "the motor controller stops by itself after 220 ms of silence"


def test_answers_from_before_the_set_point_measure_nothing():
    probe = TimeoutProbe()
    probe.accept(CLEAR, 0.0)
    probe.accept(SILENCE, 0.01)
    probe.frames(0.02)
    probe.accept(SILENCE, 0.03)
    assert probe.seconds is None
    assert list(probe.lacks()) == ["a measurement of the controller's own timeout"]
    probe.accept(CLEAR, 0.05)
    probe.accept(Values(0, 11.8, 0, 30.0, 2), 0.06)  # the kill switch is another bit
    assert probe.seconds is None
    probe.accept(Values(0, 11.8, 0, 30.0, 3), 0.12)
    assert probe.seconds == pytest.approx(0.1)


def test_a_controller_that_does_not_tell():
    probe = probed([(0.02, CLEAR), (0.22, Values(0, 11.8, 0, 30.0, None))])
    assert probe.seconds is None
    assert probe.frames(1.51) is None
    assert probe.finding() == "the motor controller has no timeout of its own, or does not tell"
    (lack,) = probe.lacks()
    assert "within 250 ms" in lack and "found: none, or not told" in lack and "--accept_esc_timeout" in lack


@pytest.mark.parametrize(
    ("measured", "accepted", "lacking", "loud"),
    [
        (0.25, 0.0, False, False),
        (0.2501, 0.0, True, False),
        (1.0, 0.0, True, False),
        (1.0, 1.0, False, True),
        (1.0, 0.9, True, False),
        (0.2, 1.0, False, False),
        (0.25, 1.0, False, False),
        (0.2, 0.1, False, False),  # less than the longest that is safe changes nothing
        (math.inf, 0.0, True, False),
        (math.inf, 100.0, True, False),
        (math.inf, math.inf, False, True),
    ],
)
def test_r12_longer_timeouts_are_accepted_only_by_the_operator(measured, accepted, lacking, loud, bridge_row):
    probe = TimeoutProbe(accepted)
    probe.seconds = measured
    assert ("ACCEPTED BY THE OPERATOR" in probe.finding()) == loud
    assert (" ms of silence" in probe.finding()) == (measured < math.inf)
    limit = 1000 * max(LONGEST_TIMEOUT, accepted)
    assert all(f"within {limit:.0f} ms" in lack for lack in probe.lacks())
    assert all(f"found: {1000 * measured:.0f} ms" in lack or measured == math.inf for lack in probe.lacks())
    bridge_row("R12", f"{measured} s, {accepted} s accepted: judged wrongly", bool(list(probe.lacks())) != lacking, 0)


def test_the_dead_man():
    hand = DeadMan()
    assert not hand.is_held(0.0) and hand.since == -math.inf
    hand.sign(1.0)
    assert hand.since == 1.0 and hand.is_held(1.0) and hand.is_held(1.0 + 0.0799)
    assert not hand.is_held(1.0801)
    for now in (1.05, 1.1, 1.15):
        hand.sign(now)
    assert hand.since == 1.0
    hand.release()
    assert not hand.is_held(1.15)
    hand.sign(1.16)
    assert hand.since == 1.16
    hand.sign(1.26)  # let go between
    assert hand.since == 1.26
    assert RELEASED + 0.02 <= 0.1
    assert HELD == 0.3


def test_the_last_sign_counts_for_exactly_its_time():
    hand = DeadMan()
    hand.sign(0.0)
    assert hand.is_held(RELEASED) and not hand.is_held(math.nextafter(RELEASED, 1))


def turned(until: float) -> WheelCheck:
    """A check that began at 0 and was looked at every 20 ms."""
    wheels = WheelCheck(0.2)
    wheels.begin(0.0)
    for step in range(round(until / 0.02)):
        wheels.angle(step * 0.02)
    return wheels


def test_r32_the_wheels_turn_left_then_right_then_straight(bridge_row):
    wheels = WheelCheck(0.2)
    assert wheels.angle(0.0) == 0.0
    wheels.begin(10.0)
    expected = {10.0: 0.1, 10.69: 0.1, 10.71: -0.1, 11.39: -0.1, 11.41: 0.0, 12.0: 0.0, 99.0: 0.0}
    wrong = sum(wheels.angle(now) != angle for now, angle in expected.items())
    bridge_row("R32", "steering that is asked for is not left, right, straight", wrong, 0)


def test_the_answer_is_taken_when_both_sides_have_been_seen():
    wheels = turned(1.6)
    assert not wheels.answer(True, 1.39) and not wheels.confirmed
    assert wheels.answer(True, 1.4) and wheels.confirmed
    assert not wheels.answer(False, 1.5) and wheels.confirmed, "said once for each look"
    wheels = turned(1.6)
    assert wheels.answer(False, 1.5) and not wheels.confirmed
    assert not wheels.answer(True, 1e6) and not wheels.confirmed, "no is not taken back without another look"
    wheels.begin(2.0)
    assert not wheels.confirmed
    assert not wheels.answer(True, 9.0)  # begun anew, not turned


@pytest.mark.parametrize("moments", [[], [0.1], [0.8], [-1.0, 0.1], [1.5, 3.0]])
def test_r32_no_answer_about_wheels_that_did_not_turn_both_ways(moments, bridge_row):
    wheels = WheelCheck(0.2)
    wheels.begin(0.0)
    for now in moments:
        wheels.angle(now)
    bridge_row("R32", f"yes is taken though wheels were turned at {moments} s only", wheels.answer(True, 5.0), 0)
    assert not wheels.confirmed


def test_no_answer_before_the_question():
    assert not WheelCheck(0.2).answer(True, 5.0)
