"""An armed car: what the wire carries while it drives, and how a drive ends."""

import math
import random
from dataclasses import replace

import pytest

from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.guard import GuardSettings
from aerial2ground.guard.states import State
from tests.aerial2ground.guard.bench import (
    ANSWER,
    BRAKE,
    CAR,
    CURRENT,
    RPM,
    SERVO,
    Bench,
    first,
    is_motion,
    sent,
    staged,
)


def test_what_a_driving_car_is_sent():
    bench = staged("driving")
    assert bench.run(0.02)[0][2] == ((RPM, 4614), (SERVO, 530), (ANSWER, 0))
    bench.steering, bench.speed = 0.1, 0.5
    bench.run(0.2)
    # -1.2135 * 0.1 + 0.5304 = 0.409
    assert bench.run(0.02)[0][2] == ((RPM, 2307), (SERVO, 409), (ANSWER, 0))
    assert bench.car.servo == 0.409


def test_r25_no_speed_is_the_brake_and_nothing_adds_up(bridge_row):
    bench = staged("driving")
    bench.steering, bench.speed = 0.1, 0.0
    log = bench.run(10.0)
    assert bench.state is State.ARMED
    assert {frames[0] for _, _, frames in log} == {(BRAKE, 10_000)}
    assert {position for _, position in sent(log[20:], SERVO)} == {409}  # it still steers
    bridge_row("R25", "10 s at speed 0: frames that ask for another", len(sent(log, RPM)), 0)
    bridge_row("R25", "10 s at speed 0: speed of the car", abs(bench.car.speed), 0, "m/s")


@pytest.mark.parametrize("gain", [-1.2135, 1.2135])
def test_r08_full_lock_stays_in_the_servos_range(gain, bridge_row):
    bench = Bench(Actuation(servo_gain=gain)).connect().look_at_wheels().arm()
    found = set()
    for side in (-0.263, 0.263):
        found |= {position for _, position in sent(bench.drive(0.5, side, 0.5).log, SERVO)}
    # 0.5304 -+ 1.2135 * 0.263 = 0.211 and 0.850
    assert (min(found), max(found)) == (211, 850)
    bridge_row("R08", f"largest servo position, gain {gain}", max(found) / 1000, 0.85)


def test_the_servos_range_holds_though_the_steering_should_leave_it():
    bench = staged("driving")
    for angle, position in ((-9.0, 850), (9.0, 150)):
        bench.guard.point.steering = angle
        bench.guard.commands.command = None  # nothing to follow: the steering is held
        assert bench.guard._car.servo(angle) > 1 or bench.guard._car.servo(angle) < 0
        bench.say("stop")
        bench.car.told["erpm"] = 3000
        bench.say("payload", bytes(1).hex())
        bench.guard.controller.values = None
        frames = bench.tick()
        assert (SERVO, position) in frames


DTS = {
    "50 Hz": lambda chance: 0.02,
    "bursts of 200 Hz": lambda chance: 0.005,
    "jitter": lambda chance: chance.uniform(0.002, 0.05),
    "pauses": lambda chance: 0.09 if chance.random() < 0.05 else 0.02,
}


@pytest.mark.parametrize("name", list(DTS))
def test_r09_steering_and_speed_on_the_wire_over_any_window(name, bridge_row):
    chance, bench = random.Random(9), staged("armed")
    begun = len(bench.log)
    for step in range(1500):
        bench.speed = 1.0 if step % 60 < 45 else 0.0
        bench.steering = 0.263 if (step if name == "50 Hz" else step // 25) % 2 else -0.263
        bench.now += DTS[name](chance)
        bench.events()
        bench.tick()
    assert bench.state is State.ARMED, bench.notes
    log = bench.log[begun:]
    servo, rpm = sent(log, SERVO), [(time, dict(frames).get(RPM, 0)) for time, _, frames in log]
    # half a step of the wire, 0.5/1000 of the servo at each end, is 8.2e-4 rad
    turned = max(fastest(servo), fastest([(time, -value) for time, value in servo])) / 1.2135 / 1000 - 8.3e-4 / 0.25
    bridge_row("R09", f"change of the steering over any 250 ms, {name}", turned, 3.2, "rad/s")
    bridge_row("R09", f"growth of the speed over any 250 ms, {name}", (fastest(rpm) - 4) / 4614, 2.5, "m/s^2")


def fastest(series, window=0.25) -> float:
    """The largest rise within any window, over the window's length."""
    worst, begin = 0.0, 0
    for last, (now, value) in enumerate(series):
        while now - series[begin][0] > window + 1e-9:
            begin += 1
        worst = max(worst, value - min(earlier for _, earlier in series[begin : last + 1]))
    return worst / window


def test_r09_no_jump_after_a_pause(bridge_row):
    bench = staged("armed")
    bench.speed, bench.steering = 1.0, 0.263
    bench.run(0.06)
    before = dict(bench.log[-1][2])
    bench.now += 0.095  # nothing is late yet
    bench.events()
    after = dict(bench.tick())
    bridge_row("R09", "growth of the speed in a pause of 95 ms", (after[RPM] - before[RPM]) / 4614, 0.0501, "m/s")
    bridge_row("R09", "steering in a pause of 95 ms", (before[SERVO] - after[SERVO]) / 1213.5, 0.0649, "rad")


def test_r10_speed_is_reduced_in_a_curve(bridge_row):
    bench = Bench(Actuation(speed_limit=2.0)).connect().look_at_wheels().arm()
    bench.drive(2.0, 0.0, 1.5)
    assert sent(bench.log, RPM)[-1][1] == 9228
    log = bench.run(0.02)
    bench.steering = 0.263
    log = bench.run(2.0)
    worst = 0.0
    for _, _, frames in log:
        speed = dict(frames)[RPM] / 4614
        worst = max(worst, speed**2 * math.tan(0.263) / 0.325)
    assert dict(log[-1][2])[RPM] == 8780  # sqrt(3 * 0.325 / tan(0.263)) = 1.9030 m/s
    bridge_row("R10", "acceleration across at 2 m/s and full lock", worst, 3.001, "m/s^2")


def test_r11_the_stop_sequence(bridge_row):
    bench = staged("driving")
    bench.steering = 0.2
    bench.run(0.5)
    turned = dict(bench.log[-1][2])[SERVO]
    bench.say("stop")
    log = bench.run(3.0)
    braking = [frames for _, state, frames in log if state is State.STOPPING]
    assert all(frames[0] == (BRAKE, 10_000) for frames in braking)
    stood = next(time for time, _, frames in log if frames[0] == (CURRENT, 0))
    assert {frames[0] for time, _, frames in log if time >= stood} == {(CURRENT, 0)}
    assert bench.state is State.DISARMED
    assert bench.notes[-2:] == ["ARMED -> STOPPING: stop", "STOPPING -> DISARMED: the car stands"]
    fast = [position for time, position in sent(log, SERVO) if time < log[0][0] + 0.28]  # 1 m/s falls to 0.1 in 0.3 s
    assert set(fast) == {turned}
    assert dict(log[-1][2])[SERVO] == 530
    assert bench.car.speed == 0
    bridge_row("R11", "brake frames, fewer than 10", max(0, 10 - len(braking)), 0)
    bridge_row("R11", "brakes for less than 0.5 s", max(0.0, 0.5 - (stood - log[0][0]) - 1e-9), 0, "s")
    # v^2 / 6 = 0.167 m, and what is driven until the first frame arrives
    bridge_row("R11", "way from 1 m/s to standing", sum_of_way(log), 0.25, "m")


def sum_of_way(log) -> float:
    """Metres that a car of 3 m/s^2 rolls from 1 m/s under the brake frames of a log; none were missing."""
    other = staged("driving")
    begun = other.car.metres
    for time, _, frames in log:
        other.car.obey(frames, time)
    return other.car.metres - begun


def test_a_car_that_stands_brakes_for_half_a_second():
    bench = staged("armed")
    bench.say("stop")
    log = bench.run(1.0)
    braking = [time for time, state, _ in log if state is State.STOPPING]
    # the first frame 20 ms after the word, which begins the half second
    assert 0.46 < braking[-1] - braking[0] < 0.5
    assert len(braking) >= 24


def test_a_car_that_rolls_on_is_braked_until_it_stands():
    bench = staged("driving")
    bench.say("stop")
    bench.car.told["erpm"] = 101
    log = bench.run(5.0)
    assert bench.state is State.STOPPING
    assert {frames[0] for _, _, frames in log} == {(BRAKE, 10_000)}
    bench.car.told["erpm"] = 98
    log = bench.run(0.4)
    stopping = [time for time, state, _ in log if state is State.STOPPING]
    assert 0.2 <= stopping[-1] - stopping[0] <= 0.24  # the answer comes a period later
    assert bench.state is State.DISARMED


@pytest.mark.parametrize("erpm", [0, 4614])
def test_a_car_that_does_not_tell_is_braked_for_three_seconds(erpm):
    bench = staged("driving")
    bench.say("stop")
    bench.car.told["erpm"] = erpm
    bench.run(0.1)
    bench.car.answers = False
    log = bench.run(4.0)
    stopping = [time for time, state, _ in log if state is State.STOPPING]
    assert 2.8 <= stopping[-1] - stopping[0] + 0.12 <= 3.02 or (erpm == 0 and len(stopping) < 30)
    assert bench.state is State.DISARMED


def test_what_is_not_known_is_braked_and_not_steered():
    bench = staged("connected")
    bench.say("check")
    bench.run(0.2)
    turned = dict(bench.log[-1][2])[SERVO]
    bench.car.answers = False
    bench.run(0.4)
    log = bench.run(2.0)
    assert {frames for _, _, frames in log} == {((BRAKE, 10_000), (SERVO, turned), (ANSWER, 0))}


def test_r03_the_hand_is_let_go(bridge_row):
    worst = 0.0
    for phase in range(10):  # at ten moments of a period
        bench = staged("driving")
        bench.hand = False
        released = bench.now + 0.002 * phase
        bench.guard.take("word", "held", released)
        log = bench.run(0.3)
        worst = max(worst, first(log, BRAKE) - released)
        assert bench.notes[-1] == "ARMED -> STOPPING: the dead-man was let go"
        assert bench.fault == ""
    bridge_row("R03", "from the last sign of the dead-man to the brake", worst, 0.1 + 1e-9, "s")


def test_r03_a_hand_that_says_so_is_let_go_at_once(bridge_row):
    bench = staged("driving")
    bench.hand = False
    bench.say("released")
    begun = bench.now
    bridge_row("R03", "from `released` to the brake", first(bench.run(0.3), BRAKE) - begun, 0.0201, "s")


def test_r03_the_hand_taken_again_does_not_drive_on(bridge_row):
    bench = staged("driving")
    bench.say("released")
    bench.tick()
    log = bench.run(3.0)  # held
    assert bench.state is State.DISARMED
    bridge_row("R03", "motion after the hand was let go and taken again", len(sent(log, RPM)), 0)


@pytest.mark.parametrize("seconds", [5.0, math.nan])
def test_r26_a_drive_ends_in_time(seconds, bridge_row):
    bench = Bench(CAR, GuardSettings(time_limit=seconds)).connect().look_at_wheels().get_ready()
    bench.hand, begun = True, bench.now + 0.32
    bench.drive(0.3, 0.0, 7.0)
    last = max([time for time, _ in sent(bench.log, RPM)], default=begun)
    limit = 5.0 if seconds == 5.0 else 0.0
    assert last - begun >= limit - 0.03
    assert bench.fault == ""
    assert bench.state is State.DISARMED
    if limit:
        assert "ARMED -> STOPPING: 5 s are over" in bench.notes
    bridge_row("R26", f"longest drive with a limit of {seconds} s", last - begun, limit + 0.021, "s")


def test_r33_every_frame_of_motion_follows_from_arming(bridge_row):
    bench = staged("driving")
    bench.say("estop")
    bench.run(5.0)
    armed = [state for _, state, frames in bench.log if any(is_motion(*frame) for frame in frames)]
    assert len(armed) > 40
    bridge_row("R33", "motion frames in other states than ARMED", sum(state is not State.ARMED for state in armed), 0)


@pytest.mark.parametrize(
    ("state", "seconds", "held", "following"),
    [
        (State.STOPPING, 3.0, 0.0, State.DISARMED),  # blind
        (State.STOPPING, 2.999, 0.0, State.STOPPING),
        (State.ARMED, 600.0, 600.0, State.ARMED),
        (State.ARMED, 600.001, 600.001, State.STOPPING),
        (State.ARMED, 1.0, 0.92, State.ARMED),
        (State.ARMED, 1.0, 0.919, State.STOPPING),
    ],
)
def test_the_last_moment_of_a_state(state, seconds, held, following):
    bench = staged("driving")
    guard = bench.guard
    guard.state, guard._entered, guard._ticked = state, 0.0, seconds - 0.02
    guard.controller.values = None if state is State.STOPPING else guard.controller.values
    guard.controller.at, guard.dead_man._sign = seconds, held
    guard.commands.command = replace(guard.commands.command, sent=seconds)
    guard.commands._new_at = seconds
    guard.tick(seconds)
    assert guard.state is following, guard.notes


@pytest.mark.parametrize(
    ("took", "standing", "halts"),
    [(0.5, 0.2, True), (0.499, 0.3, False), (0.6, 0.199, False), (2.9, 0.0, False), (3.5, 0.0, False)],
)
def test_the_end_of_a_stop(took, standing, halts):
    guard = staged("driving").guard
    guard.state, guard._entered = State.STOPPING, 0.0
    guard.controller.at = took
    guard._end_stop(standing, took)
    assert (guard.state is State.DISARMED) == halts


@pytest.mark.parametrize(
    ("since", "now", "following"),
    [
        (1.0, 1.3, State.ARMED),
        (1.0, 1.299, State.READY),
        (0.0, 1.0, State.READY),  # held when it became ready
        (1.0, 30.0, State.ARMED),
        (30.0, 30.0, State.READY),
        (30.001, 30.001, State.DISARMED),
    ],
)
def test_the_ways_out_of_ready(since, now, following):
    guard = staged("ready").guard
    guard._entered, guard.dead_man.since, guard.dead_man._sign = 0.0, since, now
    guard.lacks = lambda now: iter(())
    guard._leave_ready(now)
    assert guard.state is following


def test_the_dead_man_is_held_for_exactly_as_long_as_it_takes():
    guard = staged("ready").guard
    guard._entered, guard.dead_man.since, guard.dead_man._sign = -1.0, 0.0, 0.3
    guard.lacks = lambda now: iter(())
    guard._leave_ready(0.3)
    assert guard.state is State.ARMED


@pytest.mark.parametrize(("now", "fault"), [(0.1, None), (0.101, "GUARD_LATE")])
def test_a_tick_that_is_just_in_time(now, fault):
    guard = staged("driving").guard
    guard._ticked = guard.controller.at = guard._entered = guard.commands._new_at = 0.0
    guard.dead_man._sign = now
    guard.commands.command = replace(guard.commands.command, sent=now)
    guard.tick(now)
    assert (guard.fault and guard.fault.name) == fault


@pytest.mark.parametrize(("age", "speed"), [(0.3, 1.0), (0.301, 0.95)])
def test_answers_that_are_just_young_enough(age, speed):
    guard = staged("driving").guard
    guard.point._last = age - 0.02
    guard.controller.at = 0.0
    guard.commands.command = replace(guard.commands.command, sent=age)
    guard.commands._new_at = age
    guard._drive(age)
    assert guard.point.speed == pytest.approx(speed)
