"""The policy's process, started as the bridge starts it, with the guard's end of the socket in the test's hands."""

import contextlib
import itertools
import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from aerial2ground.bridge.camera_source import Shot
from aerial2ground.bridge.car_file import CameraCalibration
from aerial2ground.bridge.policy_process import GuardGoneError, GuardLink, Pilot, PolicySettings
from aerial2ground.bridge.recorded_pictures import recorded_pictures, replay_answers
from aerial2ground.bridge.rectification import Rectifier
from aerial2ground.exported_policy import load_exported
from aerial2ground.guard.messages import READY, Command, unpack
from aerial2ground.pure_pursuit import LowPass, share_after
from hashnerf.errors import UserError

ROOT = Path(__file__).resolve().parents[3]
FOCAL = 24 / math.tan(math.radians(50))
LENS = CameraCalibration(48, 27, FOCAL, FOCAL, 24.0, 13.5, pitch=-6.0)
GREY, WHITE = (np.full((27, 48, 3), level, np.uint8) for level in (128, 255))


class Process:
    """A running policy process; `guard` is the guard's end of the socket."""

    def __init__(self, settings: PolicySettings | str, room: int = 200_000):
        self.guard, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.guard.settimeout(20)
        theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, room)
        text = settings if isinstance(settings, str) else settings.as_json()
        with theirs:
            command = [sys.executable, "-m", "aerial2ground.bridge.policy_process", str(theirs.fileno()), text]
            self.process = subprocess.Popen(
                command, cwd=ROOT, pass_fds=[theirs.fileno()], stderr=subprocess.PIPE, text=True
            )

    def ready(self) -> "Process":
        assert self.guard.recv(100) == READY, self.process.stderr.read()
        return self

    def command(self) -> Command:
        command = unpack(self.guard.recv(100))
        assert command is not None
        return command

    def until(self, wanted) -> Command:
        """The first command that is wanted."""
        while not wanted(command := self.command()):
            pass
        return command

    def end(self) -> tuple[int, str]:
        """Exit status and what was said, once it has ended by itself."""
        while True:
            with contextlib.suppress(ConnectionError):
                if self.guard.recv(100):
                    continue
            break
        return self.process.wait(20), self.process.stderr.read()

    def close(self) -> None:
        self.guard.close()
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self.process.stderr.close()


@pytest.fixture
def start():
    with contextlib.ExitStack() as stack:

        def begin(settings, *room: int) -> Process:
            process = Process(settings, *room)
            stack.callback(process.close)
            return process

        yield begin


@pytest.fixture
def settings(onnx_policy, showing):
    """Settings of a policy that answers 0.2 rad times the brightness, and the camera that it sees."""
    shown = showing(GREY)
    policy = str(onnx_policy("brightness", 48, 27, 0.2))
    made = PolicySettings(policy, shown.stream.url, asdict(LENS), 0.8, 0.3, 0.0)
    return made, shown


def test_it_never_imports_torch():
    code = "import sys, aerial2ground.bridge.policy_process; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0


def test_ready_then_commands_and_speed_only_while_armed(start, settings):
    process = start(settings[0]).ready()
    first = process.command()
    assert first.number == 1 and first.speed == 0.0
    # the picture's mean is 128 but for the corner that counts: 0.2 * 128 / 255 = 0.1004
    assert first.steering == pytest.approx(0.1004, abs=0.01)
    assert 0 <= first.sent - first.taken < 5 and first.sent <= time.monotonic()
    for state, speed in [(b"READY", 0.0), (b"ARMED", 0.8), (b"STOPPING", 0.0), (b"ARMED", 0.8), (b"FAULT", 0.0)]:
        process.guard.send(state)
        assert process.until(lambda one, speed=speed: one.speed == speed)
        assert [process.command().speed for _ in range(3)] == [speed] * 3, "the newest answer counts"
    numbers = [process.command().number for _ in range(20)]
    assert numbers == list(range(numbers[0], numbers[0] + 20))


def test_new_pictures_steer(start, settings):
    made, shown = settings
    process = start(made).ready()
    shown.picture = WHITE
    command = process.until(lambda one: one.steering > 0.19)
    assert command.steering == pytest.approx(0.2, abs=0.01)
    pictures = {(one.picture, one.taken) for one in (process.command() for _ in range(50))}
    assert len({picture for picture, _ in pictures}) > 1, "the counting corner changes the checksum"
    assert len(pictures) == len({taken for _, taken in pictures})


def test_a_stalled_camera_keeps_commands_with_the_old_picture(start, settings):
    made, shown = settings
    process = start(made).ready()
    process.guard.send(b"ARMED")
    shown.stream.freeze("still")
    stop = time.monotonic() + 0.5
    last = process.until(lambda one: one.sent > stop)
    after = [process.command() for _ in range(20)]
    assert {(one.taken, one.picture, one.steering) for one in after} == {(last.taken, last.picture, last.steering)}
    assert all(b.sent > a.sent and b.number == a.number + 1 for a, b in itertools.pairwise(after))
    assert after[-1].sent - after[-1].taken > 0.4
    shown.stream.resume()
    assert process.until(lambda one: one.taken > last.taken)


def test_a_frozen_camera_shows_in_the_checksum(start, settings):
    made, shown = settings
    process = start(made).ready()
    shown.stream.freeze("repeat")
    stop = time.monotonic() + 0.3
    last = process.until(lambda one: one.sent > stop)
    again = process.until(lambda one: one.taken > last.taken)
    assert again.picture == last.picture


def test_no_number_ends_it_with_a_sentence(start, settings, onnx_policy):
    made, shown = settings
    shown.counting = False
    process = start(replace(made, policy=str(onnx_policy("nan_when_black", 48, 27)))).ready()
    assert process.command().steering == pytest.approx(0.1)
    shown.picture = np.zeros_like(GREY)
    status, said = process.end()
    assert status == 2 and "nan_when_black.onnx: answers nan" in said and said.count("\n") == 1


def test_an_unplugged_camera_ends_it_with_a_sentence(start, settings):
    made, shown = settings
    process = start(made).ready()
    shown.stream.unplug()
    status, said = process.end()
    assert status == 2 and said == f"{made.camera}: the camera has ended; connect it again and start anew\n"


def test_when_the_guard_closes_it_ends_quietly(start, settings):
    process = start(settings[0]).ready()
    process.command()
    process.guard.close()
    assert process.process.wait(10) == 0 and process.process.stderr.read() == ""


def test_ctrl_c_is_the_guards_business(start, settings):
    process = start(settings[0]).ready()
    process.process.send_signal(signal.SIGINT)
    for _ in range(30):
        process.command()
    assert process.process.poll() is None


def test_a_guard_that_hangs_holds_nothing_up(start, settings):
    process = start(settings[0], 5000).ready()
    process.command()
    time.sleep(0.8)  # some 50 commands; the socket holds a handful
    numbers, gap = [process.command().number], False
    while not gap:
        numbers.append(process.command().number)
        gap = numbers[-1] > numbers[-2] + 10  # it went on counting what it could not send
    process.guard.close()
    assert process.process.wait(10) == 0


@pytest.mark.parametrize(
    "change, sentence",
    [
        (lambda made, write: replace(made, policy="none.onnx"), "none.onnx: no such file"),
        (
            lambda made, write: replace(made, policy=write("constant", 48, 27, channels=4)),
            "constant.onnx: reads depth as a fourth channel, which the car's camera does not give",
        ),
        (
            lambda made, write: replace(made, policy=write("constant", 48, 27, 0.9)),
            "constant.onnx: answers 0.89999",
        ),
        (
            lambda made, write: replace(made, lens={**made.lens, "width": 64, "cx": 32.0}),
            "the camera gives pictures of 48 x 27 pixels, but the car's file says camera.width and camera.height are",
        ),
        (lambda made, write: replace(made, lens={**made.lens, "fl_x": 60.0, "fl_y": 60.0}), "policy's picture"),
        (lambda made, write: replace(made, lens={"width": 48}), "lens: "),
        (lambda made, write: replace(made, camera="97"), "97: there is no device"),
        (lambda made, write: replace(made, record="README.md"), "README.md: is there already"),
        (lambda made, write: "{}", "the settings are not a JSON object of policy, camera"),
        (lambda made, write: made.as_json().replace('"speed": 0.8', '"speed": 80'), "speed is 80; give 0 to 2 m/s"),
    ],
)
def test_what_the_user_can_mend_is_one_sentence(start, settings, onnx_policy, change, sentence):
    process = start(change(settings[0], lambda *a, **k: str(onnx_policy(*a, **k))))
    status, said = process.end()
    assert status == 2 and sentence in said and said.count("\n") == 1


def test_without_a_socket_it_says_who_starts_it():
    for arguments in ([], ["x", "{}"], ["99", "{}"]):
        command = [sys.executable, "-m", "aerial2ground.bridge.policy_process", *arguments]
        ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
        assert ended.returncode == 2 and ended.stderr.count("\n") == 1


def test_a_recorded_drive_is_answered_again(start, settings, tmp_path):
    made = replace(settings[0], record=str(tmp_path / "drive"))
    process = start(made).ready()
    seen = [process.command() for _ in range(60)]
    process.guard.close()
    assert process.process.wait(10) == 0 and process.process.stderr.read() == ""
    back = list(recorded_pictures(tmp_path / "drive"))
    assert {one.picture for one in seen} <= {one.crc for one in back}
    assert [one.answer for one in back if one.crc == seen[-1].picture][-1] == seen[-1].steering
    assert replay_answers(tmp_path / "drive", load_exported(made.policy)) == 0.0


# Within this process ------------------------------------------------------------------------------------------------


def pilot_of(path, **changes) -> Pilot:
    made = PolicySettings(**{**asdict(PolicySettings(str(path), "0", asdict(LENS), 0.8, 0.3, 0.0)), **changes})
    policy = load_exported(path)
    return Pilot(made, policy, Rectifier(LENS, policy.info), None)


def test_half_each_tenth_of_a_second_is_a_time_constant_of_0144():
    # 1 - exp(-0.1 / t) = 1 / 2 at t = 0.1 / ln 2 = 0.14427 s
    assert share_after(0.1, 0.1 / math.log(2)) == pytest.approx(0.5, abs=1e-15)
    assert share_after(0.1, 0.14427) == pytest.approx(0.5, abs=1e-5)
    assert share_after(0.1, 0.0) == 1.0 and share_after(0.0, 0.144) == 0.0 and share_after(-1.0, 0.144) == 0.0
    timed, ticked = LowPass(1.0), LowPass(0.5)
    for value in (0.0, 1.0, -1.0, 0.3):
        assert timed(value, share_after(0.1, 0.1 / math.log(2))) == pytest.approx(ticked(value), abs=1e-15)
    # two steps of 0.05 s towards the same value are one of 0.1 s
    halves = LowPass(1.0)
    for value, seconds in ((0.0, 1.0), (1.0, 0.05), (1.0, 0.05)):
        reached = halves(value, share_after(seconds, 0.2))
    assert reached == pytest.approx(1 - math.exp(-0.5), abs=1e-15)


def test_steering_is_smoothed_by_the_time_between_pictures(onnx_policy):
    pilot = pilot_of(onnx_policy("brightness", 48, 27, 0.2), low_pass_seconds=0.1 / math.log(2))
    black = np.zeros_like(GREY)
    steering = []
    for number, (picture, taken) in enumerate([(black, 5.0), (WHITE, 5.1), (WHITE, 5.3)], 1):
        pilot.look(Shot(number, picture, taken))
        steering.append(unpack(pilot.command(b"ARMED")).steering)
    # 0; half of 0.2; then 0.2 s are two halvings of what is missing: 0.2 - 0.1 / 4
    assert steering == pytest.approx([0.0, 0.1, 0.175], abs=1e-7)


def test_the_cars_limit_holds_on_both_sides(onnx_policy):
    for value in (0.7, -0.7):
        pilot = pilot_of(onnx_policy("constant", 48, 27, value), steering_limit=0.263)
        pilot.look(Shot(1, GREY, 1.0))
        assert unpack(pilot.command(b"")).steering == math.copysign(0.263, value)
        assert unpack(pilot.command(b"")).speed == 0.0


@pytest.mark.parametrize("value", [0.85, -0.85])
def test_answers_beyond_twice_what_was_trained_are_refused(onnx_policy, value):
    pilot = pilot_of(onnx_policy("constant", 48, 27, value))  # trained with 0.4189
    with pytest.raises(UserError, match=rf"answers {value:.2f}.* rad, beyond 0\.838, to picture 3"):
        pilot.look(Shot(3, GREY, 1.0))


def pair():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    return GuardLink(ours), ours, theirs


def test_a_full_socket_drops_the_command():
    link, ours, theirs = pair()
    with ours, theirs:
        while not link.dropped:
            link.send(b"command")
        link.send(b"command")
        assert link.dropped == 2
        assert theirs.recv(100) == b"command"


def test_the_newest_answer_of_the_guard_counts():
    link, ours, theirs = pair()
    with ours, theirs:
        assert link.listen() == b""
        for answer in (b"READY", b"ARMED", b"STOPPING"):
            theirs.send(answer)
        assert link.listen() == b"STOPPING" and link.listen() == b"STOPPING"


def test_a_guard_that_has_gone_is_noticed_by_both_ways():
    for act in (lambda link: link.listen(), lambda link: link.send(b"x")):
        link, ours, theirs = pair()
        with ours:
            theirs.close()
            with pytest.raises(GuardGoneError):
                act(link)


def test_settings_there_and_back():
    made = PolicySettings("a.onnx", "0", asdict(LENS), 0.8, 0.3, 0.144, "x")
    assert PolicySettings.from_json(made.as_json()) == made and made.calibration() == LENS
    for wrong in ("", "[]", "3", json.dumps({**asdict(made), "new": 1})):
        with pytest.raises(UserError, match="the settings are not a JSON object"):
            PolicySettings.from_json(wrong)
    for key, value in [("speed", math.nan), ("speed", -0.1), ("steering_limit", 15.0), ("low_pass_seconds", -1.0)]:
        with pytest.raises(UserError, match=f"^{key} is "):
            replace(made, **{key: value})


def test_no_descriptor_stays_open(start, settings):
    before = set(os.listdir("/proc/self/fd"))
    process = start(settings[0]).ready()
    process.close()
    assert len(set(os.listdir("/proc/self/fd")) - before) <= 1  # the one that lists
