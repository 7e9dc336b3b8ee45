"""The simulated car: it goes where motor and servo take it, and is counted as `driving.drive` counts."""

import json
import math
import os
import struct
import subprocess
import sys
import threading
import urllib.request
from pathlib import Path as FilePath

import numpy as np
import pytest

from aerial2ground.bridge.fake_car import (
    Console,
    FakeCarConfig,
    Lines,
    SimulatedCar,
    car_in_town,
    fake_vesc_of,
    rolled,
)
from aerial2ground.bridge.fake_vesc import FakeVesc, Motor
from aerial2ground.bridge.picture_stream import PictureStream
from aerial2ground.bridge.wire import Received
from aerial2ground.car import CarConfig, CarState
from aerial2ground.driving import DriveConfig, disturbed_start
from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.vesc import SET_RPM, SET_SERVO
from aerial2ground.paths import Path
from aerial2ground.pure_pursuit import PurePursuitConfig, steering
from aerial2ground.stages import load_driven_survey
from hashnerf.errors import UserError

REPOSITORY = FilePath(__file__).parents[3]
CAR = Actuation(servo_gain=-0.8, servo_offset=0.5, steering_limit=0.4189, wheelbase=0.33)
LINE = Path(np.array([(0.0, 0.0), (3.0, 0.0)]))
ANGLE = np.linspace(0, 2 * math.pi, 721)
CIRCLE = Path(1.5 * np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1))


def nothing(corners):
    return False


class Track:
    """A car on a bench: its motor's time is told, and what it shows is kept."""

    def __init__(self, path, start, touches=nothing, **drive):
        self.motor, self.now, self.shown = Motor(CAR, None, 10.0, 0.0), 0.0, []
        self.car = SimulatedCar(
            self.motor,
            path,
            DriveConfig(**drive),
            CarConfig(),
            CAR.wheelbase,
            start,
            lambda state: np.full((9, 16, 4), 7, np.uint8),
            touches,
            lambda picture, taken: self.shown.append((picture, taken)),
        )

    def command(self, speed, angle):
        self.motor.obey(Received(self.now, struct.pack(">Bi", SET_RPM, round(CAR.erpm(speed)))))
        self.motor.obey(Received(self.now, struct.pack(">Bh", SET_SERVO, round(1000 * CAR.servo(angle)))))

    def go(self, speed, angle, moments=1, period=0.1):
        for _ in range(moments):
            if self.car._count.arrived:
                return
            self.command(speed, angle(self.car.state) if callable(angle) else angle)
            self.now += period
            self.motor.advance(self.now)
            self.car.moment(self.now)

    @property
    def summary(self):
        return self.car.summary(self.now)


def test_an_arc_is_exact():
    # a quarter of the circle of radius 0.33 / tan(0.3)
    radius = 0.33 / math.tan(0.3)
    whole = rolled(CarState(0.0, 0.0, 0.0), radius * math.pi / 2, 0.3, 1.0, 0.33)
    assert (whole.x, whole.y, whole.yaw) == pytest.approx((radius, radius, math.pi / 2))
    state = CarState(0.0, 0.0, 0.0)
    for _ in range(7):
        state = rolled(state, radius * math.pi / 14, 0.3, 1.0, 0.33)
    assert state.pose == pytest.approx(whole.pose)
    back = rolled(whole, -radius * math.pi / 2, 0.3, -1.0, 0.33)
    assert back.pose == pytest.approx([0, 0, 0], abs=1e-12)
    assert rolled(state, 1.0, 0.0, 1.0, 0.33).yaw == state.yaw


def test_it_rests_until_it_is_driven_and_a_car_that_waits_makes_no_errors():
    track = Track(LINE, CarState(0.0, 0.1, 0.0, 0.8))
    track.go(0.0, 0.0, moments=5)
    assert track.car.state.pose.tolist() == [0.0, 0.1, 0.0] and track.car.state.speed == 0.0
    assert len(track.shown) == 5 and track.shown[2][0].shape == (9, 16, 3) and track.shown[2][1] == pytest.approx(0.3)
    summary = track.summary
    assert summary.position_rmse is None and summary.seconds == 0.0 and summary.pictures == 5


def test_a_straight_line_to_its_end():
    track = Track(LINE, CarState(0.0, 0.1, 0.0))
    track.go(1.0, 0.0, moments=100)
    # 1 m/s after 1/3 s and 1/6 m; the end, 2.98 m, is passed at 2.98 + 1/6 s; the first moment is at 0.1 s
    assert track.car.state.x == pytest.approx(3.2 - 1 / 6) and track.car.state.y == pytest.approx(0.1)
    summary = track.summary
    assert summary.laps == 1 and summary.seconds == pytest.approx(3.1) and summary.lap_seconds == [3.1]
    # 30 moments at 0.1 m, and one 1/30 m past the end besides: ((30 * 0.01 + 0.01 + 1/900) / 31)^(1/2)
    assert summary.position_rmse == pytest.approx(0.10018, abs=2e-5) and summary.yaw_rmse == pytest.approx(0.0)
    assert summary.interventions == 0 and summary.distance == pytest.approx(3.0)


def test_laps_of_a_circle_with_the_expert():
    pursuit = PurePursuitConfig()
    start = CarState(1.5, 0.0, math.pi / 2)
    track = Track(CIRCLE, start, laps=2)
    track.go(0.8, lambda state: steering(CIRCLE, state.pose, pursuit), moments=1000, period=0.05)
    summary = track.summary
    assert summary.laps == 2 and summary.interventions == 0 and summary.position_rmse < 0.03
    # 3 pi metres at 0.8 m/s
    assert summary.lap_seconds[1] == pytest.approx(3 * math.pi / 0.8, abs=0.15) and len(summary.lap_seconds) == 2
    assert 2 * CIRCLE.length <= summary.distance < 2 * CIRCLE.length + 0.05


def test_a_car_that_strays_is_put_back_and_keeps_its_speed():
    track = Track(CIRCLE, CarState(1.5, 0.0, math.pi / 2), laps=1)
    track.go(0.8, 0.0, moments=1000)
    summary = track.summary
    assert summary.laps == 1 and summary.interventions > 5
    away = np.linalg.norm(np.array(summary.put_back), axis=1) - 1.5
    assert away.min() > 0.175 and away.max() < 0.175 + 0.08
    assert track.car.state.speed == pytest.approx(0.8, abs=1e-3)


def test_what_is_touched_counts_once_a_moment():
    hits = iter([False] * 3 + [True] * 2 + [False] * 100)
    track = Track(LINE, CarState(0.0, 0.05, 0.0), touches=lambda corners: next(hits))
    track.go(1.0, 0.0, moments=10)
    # at 0.4 s and 0.5 s: 0.4 - 1/6 m and 0.1 m further
    assert track.summary.put_back == [(pytest.approx(0.233), 0.05), (pytest.approx(0.333), 0.0)]


def test_a_wrong_wheelbase_or_servo_shows_in_the_curve():
    track = Track(CIRCLE, CarState(1.5, 0.0, math.pi / 2), intervention=math.inf)
    track.go(0.8, 0.2, moments=30)
    before = track.car.state
    track.go(0.8, 0.2, moments=1)
    after = track.car.state
    turn = math.remainder(after.yaw - before.yaw, 2 * math.pi)
    assert turn == pytest.approx(0.08 * math.tan(0.2) / 0.33, rel=0.01)


def test_running_with_a_fake_controller_and_a_stream():
    stop, laps = threading.Event(), []
    with FakeVesc(CAR, timeout=None) as vesc, PictureStream() as stream:
        car = SimulatedCar(
            vesc.motor,
            Path(np.array([(0.0, 0.0), (0.2, 0.0)])),
            DriveConfig(),
            CarConfig(),
            CAR.wheelbase,
            CarState(0.0, 0.0, 0.0),
            lambda state: np.zeros((9, 16, 3), np.uint8),
            nothing,
            stream.show,
        )
        vesc.motor.runaway_erpm = 4614.0
        summary = car.run(50.0, stop, 20.0, lambda *told: laps.append(told))
        assert summary.laps == 1 and laps == [(1, summary.lap_seconds[0], 0)]
        again = car.run(50.0, stop, 20.0)
        assert again.pictures == summary.pictures, "it has arrived"


def test_running_ends_when_told_to():
    track, stop = Track(LINE, CarState(0.0, 0.0, 0.0)), threading.Event()
    assert track.car.run(100.0, stop, 0.05).pictures >= 1
    stop.set()
    before = track.summary.pictures
    assert track.car.run(100.0, stop).pictures == before
    stop.clear()
    track.car.run(100.0, stop, on_moment=stop.set)
    assert track.summary.pictures == before + 1


# commands while it runs


def test_commands():
    with FakeVesc(CAR) as vesc, PictureStream() as stream:
        console = Console(vesc, stream)
        assert console.obey("drop 0.25") == "drop 0.25: done" and vesc.drop == 0.25
        console.obey("delay 300")
        console.obey("fault 3")
        console.obey("voltage 9")
        assert (vesc.delay, vesc.fault, vesc.voltage) == (0.3, 3, 9.0)
        console.obey("runaway 900")
        assert vesc.motor.runaway_erpm == 900.0
        console.obey("kill_switch 1")
        assert vesc.motor.kill_switch is True
        console.obey("stall")
        console.obey("silent")
        assert vesc.stalled and vesc.mode == "silent"
        console.obey("answer")
        assert not vesc.stalled and vesc.mode == "answer"
        console.obey("disconnect")
        assert not vesc.plugged
        console.obey("reconnect")
        assert vesc.plugged
        for word in ("freeze", "repeat", "unplug_camera", "resume_camera"):
            assert console.obey(word) == f"{word}: done"


@pytest.mark.parametrize("line", ["drop", "drop x", "drop 1.5", "drop nan", "drop 0.1 0.2"])
def test_a_wrong_number_changes_nothing(line):
    with FakeVesc(CAR) as vesc, PictureStream() as stream:
        assert Console(vesc, stream).obey(line) == "drop: give one number from 0 to 1" and vesc.drop == 0.0


def test_anything_else_lists_the_commands():
    with FakeVesc(CAR) as vesc, PictureStream() as stream:
        for line in ("help", "stop the car", "stall 1", ""):
            answer = Console(vesc, stream).obey(line)
            assert answer.startswith("commands: stall,") and "drop NUMBER" in answer


def test_lines_come_whole_and_without_waiting():
    reading, writing = os.pipe()
    lines = Lines(reading)
    assert lines.new() == []
    os.write(writing, b"freeze\ndro")
    assert lines.new() == ["freeze"]
    os.write(writing, b"p 0.1\n\n \xff\n")
    assert lines.new() == ["drop 0.1", "\ufffd"]
    os.close(writing)
    assert lines.new() == [] and lines.new() == []
    os.close(reading)
    assert Lines(reading).new() == [] and Lines(-1).new() == []


# in the town


def config_of(folder, **changes):
    return FakeCarConfig(
        dataset=str(folder), threads=1, car_file=str(REPOSITORY / "configs/cars/mini_city.yaml"), **changes
    )


def test_it_starts_in_the_town_where_a_drive_would_but_at_rest(survey_folder, monkeypatch):
    # positions are the data set's, and the town's own differ by what loading subtracted
    monkeypatch.setattr("aerial2ground.bridge.fake_car.origin_of", lambda survey: (0.01, -0.02))
    config = config_of(survey_folder, trajectory="left_turns", seed=3, esc_timeout=0.0)
    with fake_vesc_of(config) as vesc, PictureStream() as stream:
        car = car_in_town(config, vesc, stream)
        survey = load_driven_survey(config)
        path = survey.trajectories["left_turns"]
        rng = np.random.default_rng([3, round(path.length * 1000)])
        assert car.state.pose == pytest.approx(disturbed_start(path, config.drive, config.pure_pursuit, rng).pose)
        assert car.state.speed == 0.0 and car.drive.laps == 2 and car.wheelbase == 0.33
        assert car._look.__self__.origin.tolist() == [0.01, -0.02]
        assert vesc.motor.timeout is None
        assert car.run(30.0, threading.Event(), 0.1).pictures >= 1


def test_a_trajectory_that_is_not_there_is_named(survey_folder):
    config = config_of(survey_folder, trajectory="outer_lop")
    with (
        fake_vesc_of(config) as vesc,
        PictureStream() as stream,
        pytest.raises(UserError, match=r"outer_lop.*outer_loop"),
    ):
        car_in_town(config, vesc, stream)


@pytest.mark.parametrize(
    "change", [{"laps": 0}, {"rate": 0.0}, {"delay": 501.0}, {"drop": 2.0}, {"corrupt": -1.0}, {"seconds": -1.0}]
)
def test_bad_settings_are_named(change):
    with pytest.raises(UserError, match=next(iter(change))):
        FakeCarConfig(**change)


def script(folder, tmp_path, *arguments):
    return [
        *(sys.executable, str(REPOSITORY / "scripts/fake_vesc.py"), "--dataset", str(folder), "--threads", "1"),
        *("--camera.width", "16", "--camera.height", "9", "--link", str(tmp_path / "car"), *arguments),
    ]


def test_the_script_says_where_things_are_takes_commands_and_sums_up(survey_folder, tmp_path):
    out = tmp_path / "summary.json"
    with subprocess.Popen(
        script(survey_folder, tmp_path, "--out", str(out)),
        cwd=REPOSITORY,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        port = process.stdout.readline().decode().removeprefix("port: ").strip()
        camera = process.stdout.readline().decode().removeprefix("camera: ").strip()
        assert os.path.realpath(tmp_path / "car") == os.path.realpath(port)
        with urllib.request.urlopen(camera, timeout=10) as response:
            assert response.readline() == b"--picture\r\n"
        process.stdin.write(b"runaway 4614\n")
        process.stdin.flush()
        assert process.stdout.readline() == b"runaway 4614: done\n"
        process.stdin.close()
        with urllib.request.urlopen(camera, timeout=10) as response:
            for _ in range(60):
                response.readline()
        process.terminate()
        text = process.stdout.read()
        assert process.wait(20) == 0, process.stderr.read()
    summary = json.loads(out.read_text())
    assert summary == json.loads(text) and summary["distance"] > 0.0 and summary["laps"] == 0
    assert not os.path.lexists(tmp_path / "car")


def test_the_script_runs_without_stdin(survey_folder, tmp_path):
    command = " ".join(script(survey_folder, tmp_path, "--seconds", "0.2")) + " <&-"
    done = subprocess.run(["sh", "-c", command], cwd=REPOSITORY, capture_output=True, timeout=60)
    assert done.returncode == 0 and b'"laps": 0' in done.stdout, done.stderr
