import json
import os
import subprocess
import sys
import time
import tty
from pathlib import Path

import pytest
import serial

from aerial2ground.bridge.car_file import load_car
from aerial2ground.bridge.fake_vesc import FakeVesc
from aerial2ground.bridge.launch import (
    DeployConfig,
    guard_settings,
    launch,
    new_folder,
    normal_arguments,
    policy_command,
)
from aerial2ground.bridge.picture_stream import PictureStream
from aerial2ground.bridge.rig import HEIGHT, ROOT, SCRIPT, WIDTH, MovingPicture
from aerial2ground.bridge.trial_policies import trial_policy
from hashnerf.errors import UserError

CAR = ROOT / "configs/cars/mini_city.yaml"
BUSY = 2
"""Times may be so many times as long while other tests run beside."""


@pytest.fixture
def camera():
    with PictureStream() as stream:
        picture = MovingPicture(stream)
        yield stream.url
        picture.close()


@pytest.fixture
def policy(tmp_path):
    return trial_policy(tmp_path / "policy.onnx", "constant", WIDTH, HEIGHT)


def run(*arguments: object) -> tuple[int, str, float]:
    """Exit code, what was printed, and seconds."""
    ours, theirs = os.pipe()  # stays open: a closed one ends the bridge
    start = time.monotonic()
    done = subprocess.run(
        [sys.executable, str(SCRIPT), *map(str, arguments)],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdin=ours,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=30,
    )
    took = time.monotonic() - start
    os.close(ours)
    os.close(theirs)
    return done.returncode, done.stdout.strip(), took


@pytest.mark.parametrize(
    ("words", "normal"),
    [
        (["--port"], ["--port", "list"]),
        (["--port", "--car", "a.yaml"], ["--port", "list", "--car", "a.yaml"]),
        (["--port", "/dev/ttyACM0"], ["--port", "/dev/ttyACM0"]),
        (["--dry-run"], ["--dry_run", "true"]),
        (["--dry-run", "false"], ["--dry_run", "false"]),
        (["--accept-esc-timeout", "500"], ["--accept_esc_timeout", "500"]),
        (["--log=my-folder"], ["--log=my-folder"]),
        (["--record", "--speed", "-1"], ["--record", "true", "--speed", "-1"]),
    ],
)
def test_arguments_as_operators_write_them(words, normal):
    assert normal_arguments(words) == normal


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"port": ""}, "port is not given; say --port DEVICE"),
        ({"dry_run": True}, "a dry run opens no port"),
        ({"speed": 3.0}, "speed is 3.0; give 0 to 2 m/s"),
        ({"speed": -0.1}, "speed is -0.1"),
        ({"accept_esc_timeout": -1.0}, "accept_esc_timeout is -1.0"),
        ({"time_limit": 0.0}, "time_limit is 0.0"),
        ({"time_limit": 3601.0}, "time_limit is 3601.0"),
        ({"low_pass_seconds": -1.0}, "low_pass_seconds is -1.0"),
        ({"camera": ""}, "camera is empty"),
        ({"dead_man": "datagrams"}, "say where they come to with --operator"),
    ],
)
def test_a_wrong_setting_is_named(changes, words):
    with pytest.raises(UserError, match=words):
        DeployConfig(**({"policy": "p.onnx", "port": "/dev/ttyACM0"} | changes))


def test_a_speed_over_the_cars_limit_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"speed is 1.5 m/s, over the speed_limit 1.0 of"):
        launch(DeployConfig(policy="p.onnx", port="/dev/ttyACM0", speed=1.5, car=CAR))


def test_both_processes_are_told_what_the_operator_chose():
    config = DeployConfig(policy="p.onnx", port="/dev/ttyACM0", car=CAR, accept_esc_timeout=300.0, record=True)
    car = load_car(CAR)
    command = policy_command(config, car, Path("log"))
    told = json.loads(command[-1])
    assert command[-2] == "{socket}"
    assert told["record"] == "log/pictures" and told["steering_limit"] == 0.4189 and told["lens"]["width"] == 48
    settings = guard_settings(config, car, Path("log"))
    assert settings["guard"] == {"accept_esc_timeout": 0.3, "time_limit": 600.0}
    assert settings["actuation"]["servo_gain"] == -0.8 and settings["log"] == "log"


def wrong_port(kind: str, folder: Path) -> tuple[str, str, object]:
    """The port, what must be said of it, and what has to live meanwhile."""
    if kind == "missing":
        return str(folder / "ttyACM9"), "there is no such port", None
    if kind == "null":
        return "/dev/null", "this is no serial port", None
    if kind == "file":
        (folder / "file").write_text("")
        return str(folder / "file"), "this is no serial port", None
    if kind in ("silent", "echo"):
        vesc = FakeVesc(mode=kind)
        return vesc.port, "nothing there answers as a VESC does", vesc
    if kind == "old":
        vesc = FakeVesc(firmware=(2, 18, "OLD"))
        return vesc.port, "update it to 3 or newer with VESC Tool", vesc
    master, slave = os.openpty()
    tty.setraw(master)
    held = serial.Serial(os.ttyname(slave), exclusive=True)
    return os.ttyname(slave), "another program uses this port", held


@pytest.mark.parametrize("kind", ["missing", "null", "file", "silent", "echo", "old", "busy"])
def test_r27_x5_a_port_that_cannot_be_used_is_named_at_once(kind, tmp_path, camera, policy, bridge_row):
    port, words, alive = wrong_port(kind, tmp_path)
    status, said, took = run("--policy", policy, "--camera", camera, "--car", CAR, "--port", port, "--log", tmp_path)
    if alive is not None:
        received = alive.received if isinstance(alive, FakeVesc) else []
        alive.close()
        bridge_row("X5", f"{kind} port: set-points sent", sum(len(one.payload) > 1 for one in received), 0)
    assert status == 2 and words in said and said.startswith(f"{port}: ") and "\n" not in said
    bridge_row("R27", f"{kind} port: exit code 2 and a sentence after", 1000 * took, 2000, "ms", BUSY)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("actuation: {servo_gian: -1.2}", "servo_gian"),
        ("actuation: {steering_limit: 15}", "steering_limit is 15.0; give radians"),
        ("actuation: {brake_current: -10}", "brake_current is -10.0; give positive amperes"),
        ("camera: {width: 48}", "fl_x"),
    ],
)
def test_r27_a_wrong_car_file_is_named_at_once(text, words, tmp_path, bridge_row):
    file = tmp_path / "car.yaml"
    lens = "\ncamera: {width: 48, height: 27, fl_x: 20, fl_y: 20, cx: 24, cy: 13.5}"
    file.write_text(text + ("" if "camera" in text else lens))
    status, said, took = run("--policy", "p.onnx", "--port", "/dev/null", "--car", file)
    assert status == 2 and words in said and str(file) in said and "\n" not in said
    bridge_row("R27", f"car file with {words.split(';')[0]}: exit code 2 after", 1000 * took, 2000, "ms", BUSY)


@pytest.mark.parametrize(
    ("made", "words"),
    [
        ({"channels": 4}, "reads depth"),
        ({"field_of_view": 120.0}, "policy.onnx: 52 % of the policy's picture"),
        (None, "no such file"),
    ],
)
def test_r27_a_policy_that_does_not_fit_is_named_at_once(made, words, tmp_path, camera, bridge_row):
    file = tmp_path / "policy.onnx"
    if made is not None:
        trial_policy(file, "constant", WIDTH, HEIGHT, **made)
    with FakeVesc() as vesc:
        status, said, took = run(
            "--policy", file, "--camera", camera, "--car", CAR, "--port", vesc.port, "--log", tmp_path
        )
        assert all(len(one.payload) == 1 for one in vesc.received), "only questions"
    assert status == 2 and words in said and "\n" not in said
    bridge_row("R27", f"policy that {words}: exit code 2 after", 1000 * took, 2000, "ms", BUSY)


def test_r27_a_dry_run_opens_no_port(tmp_path, camera, policy, bridge_row):
    command = [
        sys.executable,
        str(SCRIPT),
        "--policy",
        str(policy),
        "--camera",
        camera,
        "--dry-run",
        "--log",
        str(tmp_path),
    ]
    bridge = subprocess.Popen(
        [*command, "--car", str(CAR)],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    line = next(line for line in bridge.stdout if line.startswith("steering"))
    files = [os.readlink(f"/proc/{bridge.pid}/fd/{name}") for name in os.listdir(f"/proc/{bridge.pid}/fd")]
    ports = [file for file in files if file.startswith("/dev/") and file != "/dev/null"]
    bridge.stdin.close()
    assert bridge.wait(10) == 0
    bridge.stdout.close()
    assert line.startswith("steering +0.100 rad")
    bridge_row("R27", "devices open in a dry run", len(ports), 0)


def test_ports_are_listed():
    status, said, _ = run("--port")
    assert status == 0 and said


def test_every_start_has_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.setattr(time, "strftime", lambda format: "20260101-120000")
    names = [new_folder(tmp_path / "log").name for _ in range(3)]
    assert names == ["20260101-120000", "20260101-120000-1", "20260101-120000-2"]
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="file: no log can be kept there"):
        new_folder(tmp_path / "file")


def test_descriptors_that_the_caller_closed_do_not_become_sockets(tmp_path, camera, policy):
    # without them the policy's socket would get number 0, and be read as the keyboard
    with FakeVesc() as vesc:
        arguments = ["--policy", policy, "--camera", camera, "--car", CAR, "--port", vesc.port, "--log", tmp_path]
        done = subprocess.run(
            ["sh", "-c", 'exec "$@" <&-', "sh", sys.executable, str(SCRIPT), *map(str, arguments)],
            cwd=ROOT,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            timeout=30,
        )
    assert done.returncode == 0 and "standard input is closed" in done.stdout
    assert "is no command" not in done.stdout + done.stderr
