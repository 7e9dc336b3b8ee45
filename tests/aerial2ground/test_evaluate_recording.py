"""Blocks, baselines and R2 by hand; a drive whose steering can be seen, and one where it cannot."""

from pathlib import Path

import numpy as np
import pytest
import torch

from aerial2ground.donkeycar import Recording
from aerial2ground.evaluate_recording import (
    RecordingConfig,
    block_splits,
    explained,
    linear_answers,
    mirrored,
    network_answers,
    predictions,
    small_pixels,
)
from aerial2ground.networks import NetworkConfig
from aerial2ground.policy_training import AugmentationConfig, TaskConfig
from hashnerf.command_line import load_config
from hashnerf.errors import UserError

PLAIN = AugmentationConfig(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
QUICK = TaskConfig(NetworkConfig(filters=4, layers=2, hidden=8), PLAIN, epochs=20, batch_size=32)
BRIEF = TaskConfig(QUICK.network, PLAIN, epochs=2, batch_size=32)


def drive(frames: int = 120) -> Recording:
    """A bright bar on grey; the driver steers towards it, and it wanders as slowly as a track does."""
    wanted = 0.8 * np.sin(np.arange(frames) / 7.0)
    pictures = np.full((frames, 12, 20, 3), 60, np.uint8)
    for row, value in enumerate(wanted):
        middle = round(9.5 + 8 * value)
        pictures[row, 4:, max(middle - 1, 0) : middle + 2] = 220
    return Recording(torch.from_numpy(pictures), wanted, np.ones(frames), np.arange(frames))


def test_blocks_with_a_gap_by_hand():
    splits = block_splits(10, 2, 2)
    assert splits[0][1].tolist() == [0, 1, 2, 3, 4] and splits[0][0].tolist() == [7, 8, 9]
    assert splits[1][1].tolist() == [5, 6, 7, 8, 9] and splits[1][0].tolist() == [0, 1, 2]
    middle_train, middle_test = block_splits(9, 3, 1)[1]
    assert middle_test.tolist() == [3, 4, 5] and middle_train.tolist() == [0, 1, 7, 8]


def test_blocks_that_cannot_be():
    with pytest.raises(UserError, match="3 frames are too few for 4 blocks"):
        block_splits(3, 4, 0)
    with pytest.raises(UserError, match="leave none to learn from"):
        block_splits(10, 2, 5)


def test_explained_variance_by_hand():
    truth = np.array([0.0, 1.0, 2.0, 3.0])  # mean 1.5, squared deviations 2.25 + 0.25 + 0.25 + 2.25 = 5
    assert explained(truth, truth) == 1.0
    assert explained(truth, np.full(4, 1.5)) == 0.0
    assert explained(truth, np.array([0.0, 1.0, 2.0, 2.0])) == pytest.approx(1 - 1 / 5)
    assert explained(truth, truth + 2) == pytest.approx(1 - 16 / 5)
    assert explained(np.ones(3), np.ones(3)) == 1.0 and explained(np.ones(3), np.zeros(3)) == 0.0


def test_mirror_and_small():
    pictures = torch.arange(2 * 4 * 40 * 3, dtype=torch.uint8).view(2, 4, 40, 3)
    assert torch.equal(mirrored(pictures)[:, :, 0], pictures[:, :, -1])
    assert torch.equal(mirrored(mirrored(pictures)), pictures)
    halves = torch.zeros(1, 2, 40, 3, dtype=torch.uint8)
    halves[:, :, 1::2] = 255
    assert small_pixels(halves).tolist() == [pytest.approx([0.5] * 20 * 3)], "2 x 40 pixels become 1 x 20"


def test_the_network_and_the_line_see_what_they_have_not_learned():
    config = RecordingConfig("unread", blocks=3, gap=3, task=QUICK, threads=1)
    recording = drive()
    answers = predictions(config, recording, block_splits(120, 3, 3))
    r2 = {name: explained(recording.steering, answer) for name, answer in answers.items()}
    assert r2["constant"] < 0.05 and r2["linear"] > 0.5 and r2["network"] > 0.5


def test_noise_teaches_nothing():
    rng = np.random.default_rng(0)
    pictures = torch.from_numpy(rng.integers(0, 255, (90, 12, 20, 3), dtype=np.uint8))
    recording = Recording(pictures, rng.uniform(-1, 1, 90), np.ones(90), np.arange(90))
    train, test = block_splits(90, 3, 3)[1]
    answer = linear_answers(RecordingConfig("unread"), recording, train, test)
    assert explained(recording.steering[test], answer) < 0.2
    assert np.abs(answer).max() <= 1


def test_held_out_frames_are_not_learned_from():
    config = RecordingConfig("unread", task=BRIEF, blocks=3, gap=3)
    recording = drive()
    train, test = block_splits(120, 3, 3)[1]
    changed = recording.steering.copy()
    changed[np.setdiff1d(np.arange(120), train)] = 0.123
    other = Recording(recording.pictures, changed, recording.throttle, recording.index)
    for answers in (network_answers, linear_answers):
        arguments = (train, test, 0) if answers is network_answers else (train, test)
        assert np.array_equal(answers(config, recording, *arguments), answers(config, other, *arguments))


def test_a_seed_decides_everything():
    recording, (train, test) = drive(60), block_splits(60, 2, 3)[0]
    one, again = (network_answers(RecordingConfig("unread", task=BRIEF), recording, train, test, 0) for _ in range(2))
    other = network_answers(RecordingConfig("unread", task=BRIEF), recording, train, test, 1)
    assert np.array_equal(one, again) and not np.array_equal(one, other)


@pytest.mark.parametrize(
    "changes, sentence",
    [
        ({"blocks": 1}, "blocks is 1"),
        ({"gap": -1}, "gap is -1"),
        ({"width": 4}, "width is 4"),
        ({"out": "."}, "out is ., a folder; give a file"),
    ],
)
def test_bad_settings_are_named(changes, sentence):
    with pytest.raises(UserError, match=sentence):
        RecordingConfig("unread", **changes)


PRESETS = sorted((Path(__file__).resolve().parents[2] / "configs" / "aerial2ground").glob("recording*.yaml"))


@pytest.mark.parametrize("preset", PRESETS, ids=lambda path: path.stem)
def test_presets_load(preset, tmp_path):
    whole = tmp_path / "whole.yaml"
    whole.write_text(preset.read_text() + "data: somewhere\n")
    assert load_config(RecordingConfig, whole).blocks == 5
