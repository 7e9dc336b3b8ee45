import json
import os
import shutil

import pytest

from aerial2ground.bridge.policy_process import load_exported
from aerial2ground.bridge.recorded_pictures import replay_answers
from aerial2ground.bridge.replay import LARGEST, LOG, read_log, replay
from aerial2ground.bridge.rig import Rig
from hashnerf.errors import UserError
from scripts.replay_drive import draw


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A short recorded drive that ends with an emergency stop: its black box and its policy."""
    folder = tmp_path_factory.mktemp("drive")
    with Rig(folder, ["--record"], policy="brightness") as rig:
        rig.confirm_wheels()
        rig.arm()
        rig.press(" ")
        rig.wait_for_words("-> FAULT")
        rig.say("quit")
        assert rig.bridge.wait(10) == 0
    return next((folder / "log").iterdir()), folder / "policy.onnx"


def test_r29_log_and_policy_give_the_drive_again(drive, bridge_row):
    log, policy = drive
    again = replay(log)
    assert again.periods > 150 and again.faults == ("E_STOP",)
    bridge_row("R29", f"of {again.periods} periods replayed, those with other bytes", again.different, 0)
    apart = replay_answers(log / "pictures", load_exported(policy))
    bridge_row("R29", "answers to the recorded pictures, off by", apart, 0, "rad")


def test_a_changed_input_gives_other_bytes(drive, tmp_path):
    records = read_log(drive[0])
    moving = next(index for index, record in enumerate(records) if record.get("state") == "ARMED")
    records[moving]["in"].append([records[moving]["t"], "word", "estop"])
    (tmp_path / LOG).write_text("\n".join(map(json.dumps, records)))
    assert replay(tmp_path).different > 10


def test_a_cut_last_line_is_left_out_and_a_damaged_one_named(drive, tmp_path):
    shutil.copy(drive[0] / LOG, tmp_path / LOG)
    whole = (tmp_path / LOG).read_text()
    count = len(whole.splitlines())
    (tmp_path / LOG).write_text(whole[:-20])
    assert replay(tmp_path).periods == count - 2
    (tmp_path / LOG).write_text(whole.replace('"state"', "state", 1))
    with pytest.raises(UserError, match="line 2 is no record"):
        replay(tmp_path)


@pytest.mark.parametrize(
    "text", ["", '{"actuation": {"wheels": 4}, "guard": {}}', '{"actuation": {}, "guard": {}}\n{"t": 1}']
)
def test_what_is_no_black_box_is_named(text, tmp_path):
    with pytest.raises(UserError, match="no such black box"):
        replay(tmp_path)
    (tmp_path / LOG).write_text(text)
    with pytest.raises(UserError, match=r"log\.jsonl: is no black box of this version"):
        replay(tmp_path)


@pytest.mark.parametrize(
    "line", [b"\xff\xfe\x00", b'{"t":' + b"[" * 100_000, b'{"t": 1' + b"0" * 400 + b', "in": [], "out": ""}', b"5"]
)
def test_a_black_box_that_was_damaged_is_named(drive, tmp_path, line):
    head = (drive[0] / LOG).read_bytes().splitlines()[0]
    (tmp_path / LOG).write_bytes(b"\n".join([head, line, b"{}"]))
    with pytest.raises(UserError, match=r"log\.jsonl"):
        replay(tmp_path)
    with pytest.raises(UserError, match=r"drive|damaged"):
        draw(tmp_path, tmp_path / "drive.png")


def test_a_file_that_is_too_large_for_a_black_box_is_not_read(tmp_path):
    with open(tmp_path / LOG, "wb") as file:
        file.truncate(LARGEST + 1)
    with pytest.raises(UserError, match="is over 200 MB"):
        read_log(tmp_path)


def test_a_chart_replaces_no_device_and_makes_no_folder(drive, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for place in (tmp_path / "pipe", tmp_path, tmp_path / "none" / "drive.png"):
        with pytest.raises(UserError, match="no picture can be written there"):
            draw(drive[0], place)
    assert (tmp_path / "pipe").is_fifo()
    draw(drive[0], tmp_path / "drive.png")
    assert (tmp_path / "drive.png").read_bytes()[:4] == b"\x89PNG"
