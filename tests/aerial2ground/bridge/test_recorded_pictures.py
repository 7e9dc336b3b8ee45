"""What was recorded is read back to the bit, and a disk that hangs or is full costs pictures but no time."""

import binascii
import json
import os
import threading
from pathlib import Path

import numpy as np
import pytest

from aerial2ground.bridge import recorded_pictures
from aerial2ground.bridge.camera_source import Shot
from aerial2ground.bridge.car_file import CameraCalibration
from aerial2ground.bridge.recorded_pictures import Recorder, recorded_lens, replay_answers
from aerial2ground.bridge.recorded_pictures import recorded_pictures as read
from aerial2ground.bridge.rectification import Rectifier
from aerial2ground.exported_policy import load_exported
from hashnerf.errors import UserError

LENS = CameraCalibration(64, 48, 26.0, 26.0, 32.0, 24.0, k1=0.01, pitch=-6.0)
PICTURES = np.random.default_rng(0).integers(0, 256, (5, 48, 64, 3), dtype=np.uint8)


def record(folder: Path, answers, close=True) -> Recorder:
    recorder = Recorder(folder, LENS)
    for number, (picture, answer) in enumerate(zip(PICTURES, answers), 1):
        recorder(Shot(2 * number, picture, 100.0 + number / 7), binascii.crc32(picture), answer)
    if close:
        recorder.close()
    return recorder


@pytest.fixture
def policy(onnx_policy):
    return load_exported(onnx_policy("brightness", 16, 9, 0.3))


def answers_of(policy):
    rectify = Rectifier(LENS, policy.info)
    return [policy(rectify(picture)) for picture in PICTURES]


def test_there_and_back_to_the_bit(tmp_path):
    answers = [0.1, -0.2, 1 / 3, 0.0, 1e-9]
    recorder = record(tmp_path / "drive", answers)
    assert (recorder.written, recorder.dropped) == (5, 0)
    back = list(read(tmp_path / "drive"))
    assert all(np.array_equal(one.picture, picture) for one, picture in zip(back, PICTURES))
    assert [one.answer for one in back] == answers
    assert [one.number for one in back] == [2, 4, 6, 8, 10]
    assert [one.taken for one in back] == [100.0 + number / 7 for number in range(1, 6)]
    assert recorded_lens(tmp_path / "drive") == LENS


def test_the_same_policy_answers_the_same(tmp_path, policy):
    record(tmp_path / "drive", answers_of(policy))
    assert replay_answers(tmp_path / "drive", policy) == 0.0


def test_another_policy_answers_otherwise(tmp_path, policy, onnx_policy):
    answers = answers_of(policy)
    answers[3] += 0.01
    record(tmp_path / "drive", answers)
    assert replay_answers(tmp_path / "drive", policy) == pytest.approx(0.01)
    other = load_exported(onnx_policy("constant", 16, 9, 0.0))
    assert replay_answers(tmp_path / "drive", other) == pytest.approx(max(answers))


def test_a_picture_that_changed_on_the_disk_is_named(tmp_path, policy):
    record(tmp_path / "drive", answers_of(policy))
    data = bytearray((tmp_path / "drive/pictures.raw").read_bytes())
    data[2 * PICTURES[0].nbytes + 7] ^= 1
    (tmp_path / "drive/pictures.raw").write_bytes(data)
    with pytest.raises(UserError, match=r"pictures\.raw: picture 6 is damaged"):
        replay_answers(tmp_path / "drive", policy)


def test_what_a_killed_process_leaves_is_read_up_to_there(tmp_path, policy):
    record(tmp_path / "drive", answers_of(policy))
    index, pictures = tmp_path / "drive/index.jsonl", tmp_path / "drive/pictures.raw"
    index.write_text(index.read_text()[:-9])  # in the middle of the last line
    assert len(list(read(tmp_path / "drive"))) == 4
    with open(pictures, "ab") as file:
        file.write(b"half a picture")
    assert replay_answers(tmp_path / "drive", policy) == 0.0


def test_folders_that_are_no_recording(tmp_path, policy):
    with pytest.raises(UserError, match=r"pictures\.raw, index\.jsonl; start the drive with --record true"):
        replay_answers(tmp_path, policy)
    record(tmp_path / "drive", [])
    with pytest.raises(UserError, match="holds no whole picture"):
        replay_answers(tmp_path / "drive", policy)
    (tmp_path / "drive/index.jsonl").write_text("[1]\n")
    with pytest.raises(UserError, match=r"index\.jsonl: '\[1\]' is no line of a recording"):
        replay_answers(tmp_path / "drive", policy)
    (tmp_path / "drive/recording.json").write_text(json.dumps({"width": 3}))
    with pytest.raises(UserError, match=r"recording\.json: is no camera's calibration"):
        replay_answers(tmp_path / "drive", policy)


def test_nothing_is_written_over(tmp_path):
    record(tmp_path / "drive", [0.1])
    with pytest.raises(UserError, match="is there already; give record a new folder"):
        Recorder(tmp_path / "drive", LENS)
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="is there already"):
        Recorder(tmp_path / "file", LENS)
    with pytest.raises(UserError, match="cannot be written"):
        Recorder(tmp_path / "file/drive", LENS)


def test_a_disk_that_hangs_costs_pictures_and_no_time(tmp_path, monkeypatch):
    hangs = threading.Event()
    monkeypatch.setattr(recorded_pictures, "WAITING", 2)
    free = recorded_pictures.shutil.disk_usage(tmp_path)

    def slow(folder):
        hangs.wait()
        return free

    monkeypatch.setattr(recorded_pictures.shutil, "disk_usage", slow)
    recorder = record(tmp_path / "drive", [0.0] * 5, close=False)  # returns while the disk hangs
    assert recorder.written == 0 and recorder.dropped in (2, 3)  # two wait, and one may be on its way
    dropped = recorder.dropped
    hangs.set()
    recorder.close()
    assert (recorder.written, recorder.dropped) == (5 - dropped, dropped)
    assert len(list(read(tmp_path / "drive"))) == 5 - dropped


def test_the_last_of_the_disk_is_left_to_others(tmp_path, monkeypatch):
    monkeypatch.setattr(recorded_pictures, "SPARE", 10**18)
    recorder = record(tmp_path / "drive", [0.0] * 5)
    assert (recorder.written, recorder.dropped) == (0, 5)


def test_a_full_disk_ends_the_recording_and_nothing_else(tmp_path, monkeypatch):
    monkeypatch.setattr(recorded_pictures, "PICTURES", os.path.join("..", "full"))
    (tmp_path / "full").symlink_to("/dev/full")
    recorder = record(tmp_path / "drive", [0.0] * 5)
    assert (recorder.written, recorder.dropped) == (0, 5)
