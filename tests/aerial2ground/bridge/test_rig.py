"""The whole bridge as an operator starts it, against the fake controller: what its bytes do when things go wrong."""

import os
import signal
import statistics
import subprocess
import sys
import time

import numpy as np
import pytest

from aerial2ground.bridge.rig import Rig
from aerial2ground.bridge.wire import brake_frames, max_gap, motion_frames, of_kind, periods, strangers
from aerial2ground.guard.vesc import SET_CURRENT, SET_RPM, SET_SERVO

BUSY = 2
"""Times may be so many times as long while other tests run beside."""


def armed(tmp_path, *arguments, **options) -> Rig:
    """A rig whose car drives."""
    rig = Rig(tmp_path, arguments, **options)
    rig.confirm_wheels()
    rig.arm()
    return rig


def test_r01_r25_nothing_moves_before_arming_and_a_speed_of_nought_stands(tmp_path, bridge_row):
    with Rig(tmp_path, ["--speed", "0"]) as rig:
        rig.confirm_wheels()
        time.sleep(2)
        received = rig.vesc.take()
        bridge_row("R01", "motion frames while disarmed", len(motion_frames(received)) + len(strangers(received)), 0)
        assert of_kind(received, SET_CURRENT) and of_kind(received, SET_SERVO)
        rig.arm(speed=0.0)
        time.sleep(2)
        bridge_row("R25", "motion frames, armed with --speed 0 for 2 s", len(motion_frames(rig.vesc.take())), 0)
        assert rig.vesc.state.distance == 0


def test_r04_r30_x7_the_period_holds_beside_other_work(tmp_path, bridge_row):
    hog = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        with armed(tmp_path) as rig:
            rig.vesc.take()
            time.sleep(4)
            received = rig.vesc.take()
            assert rig.said("STOPPING") is None
            dropped = rig.vesc.dropped
    finally:
        hog.kill()
        hog.wait()
    times = np.array(periods(received, SET_RPM)) * 1000
    assert len(times) > 100
    bridge_row(
        "R04", "median period off 20 ms, beside a busy process, 4 s", abs(statistics.median(times) - 20), 1, "ms", BUSY
    )
    bridge_row("R04", "period of 99 of 100", float(np.percentile(times, 99)), 30, "ms", BUSY)
    bridge_row("R30", "longest gap", max_gap(received, SET_RPM) * 1000, 60, "ms", BUSY)
    bridge_row("X7", "bytes at the controller that belong to no whole frame", dropped, 0)


@pytest.mark.parametrize(
    ("number", "expected"),
    [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGTSTP, 148), (None, 0)],
)
def test_r11_r13_x2_a_signal_stops_the_car_before_the_end(number, expected, tmp_path, bridge_row):
    with armed(tmp_path) as rig:
        start = time.monotonic()
        if number is None:
            rig.hold(False)
            rig.bridge.stdin.close()
        else:
            rig.bridge.send_signal(number)
            rig.bridge.send_signal(number)  # a second one changes nothing
        status = rig.bridge.wait(10)
        took = time.monotonic() - start
        time.sleep(0.1)
        received = [one for one in rig.vesc.received if one.time >= start]
        name = "standard input closed" if number is None else f"{number.name} twice"
        assert status == expected
        bridge_row("R13", f"{name}: ended after", 1000 * took, 1000, "ms", BUSY)
        brakes = brake_frames(received)
        bridge_row("R11", f"{name}: brake frames short of ten", max(0, 10 - len(brakes)), 0)
        after = [one for one in motion_frames(received) if one.time > brakes[0].time]
        bridge_row("X2", f"{name}: motion frames after the first brake frame", len(after), 0)
        assert brakes[-1].time - brakes[0].time >= 0.45
        assert of_kind(received, SET_CURRENT)[-1].time > brakes[-1].time, "the motor is released at last"
        assert abs(rig.vesc.state.speed) < 0.05
        assert rig.policy_process() is None


def test_r13_the_car_stops_when_whoever_started_the_bridge_dies(tmp_path, bridge_row):
    rig = Rig(tmp_path, start=False)
    rig.command = [sys.executable, "-c", "import subprocess, sys; subprocess.run(sys.argv[1:])", *rig.command]
    with rig:
        rig.start()
        rig.confirm_wheels()
        rig.arm()
        bridge = rig.policy_process()  # the only child of the process in between
        start = time.monotonic()
        rig.bridge.kill()
        took = rig.first_brake(start, 0.3)
        bridge_row("R13", "parent killed: first brake frame after", 1000 * took, 150, "ms", BUSY)
        rig.wait_for(lambda: not os.path.exists(f"/proc/{bridge}"), "the end of the bridge")


def test_r15_a_killed_guard_sends_nothing_and_the_controller_stops_by_itself(tmp_path, bridge_row):
    with armed(tmp_path, policy="constant") as rig:
        before = rig.vesc.state
        rig.bridge.kill()
        rig.bridge.wait()
        rig.vesc.take()
        rig.wait_for(lambda: rig.vesc.state.speed == 0, "standing")
        rolled, speed = rig.vesc.state.distance - before.distance, before.speed
        bridge_row("R15", "frames after the guard was killed", len(rig.vesc.take()), 0)
        # 0.25 s of its timeout at full speed, then 3 m/s^2: v t + v^2 / 2 a
        bridge_row("R15", f"rolled from {speed:.2f} m/s", rolled, speed * 0.25 + speed**2 / 6 + 0.02, "m", BUSY)


def test_r16_a_guard_that_slept_brakes_first(tmp_path, bridge_row):
    with armed(tmp_path) as rig:
        rig.bridge.send_signal(signal.SIGSTOP)
        time.sleep(2)
        start = time.monotonic()
        rig.bridge.send_signal(signal.SIGCONT)
        rig.wait_for_words("GUARD_LATE")
        time.sleep(0.5)
        after = [one for one in rig.vesc.received if one.time >= start]
        bridge_row("R16", "motion frames after SIGSTOP for 2 s and SIGCONT", len(motion_frames(after)), 0)
        assert brake_frames(after)


def test_r17_r18_an_unplugged_port_is_named_and_never_arms_by_itself(tmp_path, bridge_row):
    with armed(tmp_path) as rig:
        start = time.monotonic()
        rig.vesc.disconnect()
        rig.wait_for_words("LINK_LOST")
        bridge_row("R17", "fault named after", 1000 * (rig.said("LINK_LOST") - start), 100, "ms", BUSY)
        old = rig.vesc.port
        time.sleep(0.3)
        rig.vesc.take()
        rig.vesc.reconnect()
        rig.wait_for_words("stops by itself", start)
        time.sleep(1.0)  # the dead-man is held all the time
        rig.say("arm")
        rig.wait_for_words("a look at the wheels", start)
        assert rig.bridge.poll() is None and "Traceback" not in str(rig.heard)
        what = "motion frames after it was plugged in again" + ("" if rig.vesc.port == old else ", under another name")
        bridge_row("R18", what, len(motion_frames(rig.vesc.take())), 0)
        rig.hold(False)
        rig.confirm_wheels()
        rig.arm()  # by the operator it can


def test_r31_the_controller_hears_nothing_before_the_camera_works(tmp_path, bridge_row):
    rig = Rig(tmp_path, start=False)
    with rig:
        rig.picture.paused = True
        rig.start()
        rig.wait_for(lambda: rig.vesc.received, "a question for the firmware")
        time.sleep(0.5)
        early = [one for one in rig.vesc.take() if len(one.payload) > 1]
        rig.picture.paused = False
        rig.wait_for_words("the motor controller")
        bridge_row("R31", "set-points before the first picture", len(early), 0)
        rig.say("quit")
        assert rig.bridge.wait(10) == 0


def test_x3_a_controller_that_takes_no_bytes_does_not_hold_up_the_loop(tmp_path, bridge_row):
    with armed(tmp_path) as rig:
        start = time.monotonic()
        rig.vesc.clog()
        rig.wait_for_words("LINK_BLOCKED")
        bridge_row("X3", "blocked port named after", 1000 * (rig.said("LINK_BLOCKED") - start), 250, "ms", BUSY)
        time.sleep(0.5)
        rig.press(" ")
        rig.vesc.answer()
        time.sleep(0.5)
        gone = [one for one in motion_frames(rig.vesc.received) if one.time > start + 1]
        bridge_row("X3", "motion frames when it takes them again", len(gone), 0)
        rig.say("quit")
        assert rig.bridge.wait(10) == 0


def test_x6_the_guard_never_loads_torch_nor_the_policy(bridge_row):
    code = (
        "import sys; before = set(sys.modules); import aerial2ground.guard.guard_process; "
        "own = {name.split('.')[0] for name in set(sys.modules) - before} - set(sys.stdlib_module_names); "
        "print(*sorted(own - {'aerial2ground', 'hashnerf', 'serial'})); "
        "print(*sorted(name for name in sys.modules if name.startswith(('hashnerf.', 'aerial2ground.bridge'))))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    foreign, ours = done.stdout.splitlines()
    bridge_row("X6", f"foreign modules in the guard {foreign}".strip(), len(foreign.split()), 0)
    assert ours.split() == ["hashnerf.errors"]
