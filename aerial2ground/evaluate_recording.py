"""The steering network on a recorded drive: how much of the driver's steering it finds in pictures it has not seen.

Neighbouring frames are nearly alike, so frames are held out in contiguous blocks, and the frames within `gap` of a
block are left out of its training. R2 = 1 - squared error / squared deviation from the mean of the same frames; over
all blocks together it is pooled: one mean, one sum.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from sklearn.linear_model import RidgeCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from torch import Tensor

from aerial2ground.donkeycar import Recording, read_tub
from aerial2ground.policy_training import TaskConfig, as_input, train_network
from hashnerf.command_line import set_threads
from hashnerf.errors import UserError

STRENGTHS = np.logspace(0, 6, 13)
"""Ridge penalties to choose from."""
LINEAR_WIDTH = 20
"""Pixels across that the linear baseline reads: with more of them it only remembers."""
Indices = Int[np.ndarray, " _"]
OnBlock = Callable[[int, int], None]


@dataclass(frozen=True)
class RecordingConfig:
    """A recorded drive, how it is split and what learns from it."""

    data: str
    """Folder of the recording (a donkeycar tub, version 2)."""
    width: int = 80
    """Width to which pictures are reduced."""
    mirror: bool = True
    """Learn also from mirrored pictures with the steering turned round."""
    blocks: int = 5
    """Contiguous blocks; each is held out once."""
    gap: int = 20
    """Frames on both sides of a held-out block that nothing learns from."""
    task: TaskConfig = field(default_factory=TaskConfig)
    """The network and its training."""
    out: str = ""
    """JSON file to write the figures to; empty: they are only printed."""
    seed: int = 0
    """Seed of everything random."""
    threads: int = 1
    """Processor threads; 0 uses all cores."""

    def __post_init__(self):
        if self.blocks < 2:
            raise UserError(f"blocks is {self.blocks}; give at least 2")
        if self.gap < 0:
            raise UserError(f"gap is {self.gap}; give 0 or more frames")
        if self.width < 8:
            raise UserError(f"width is {self.width}; give at least 8 pixels")
        if self.out and Path(self.out).is_dir():
            raise UserError(f"out is {self.out}, a folder; give a file to be written")


def evaluate_recording(config: RecordingConfig, on_block: OnBlock = lambda done, total: None) -> dict:
    """Returns R2 and mean absolute error of the network and both baselines, pooled and for every held-out block."""
    set_threads(config.threads)
    recording = read_tub(Path(config.data), config.width)
    splits = block_splits(len(recording.steering), config.blocks, config.gap)
    start = time.perf_counter()
    answers = predictions(config, recording, splits, on_block)
    results = {"frames": len(recording.steering), "seconds": round(time.perf_counter() - start, 1)}
    truth = recording.steering
    for name, answer in answers.items():
        results[name] = {
            "r2": explained(truth, answer),
            "r2_blocks": [explained(truth[test], answer[test]) for _, test in splits],
            "mean_absolute_error": float(np.abs(truth - answer).mean()),
        }
    return results


def block_splits(count: int, blocks: int, gap: int) -> list[tuple[Indices, Indices]]:
    """Returns (training, held-out) frame numbers of every block; raises UserError where none is left to learn from."""
    frames = np.arange(count)
    splits = []
    for test in np.array_split(frames, blocks):
        if len(test) == 0:
            raise UserError(f"{count} frames are too few for {blocks} blocks; give fewer")
        train = frames[(frames < test[0] - gap) | (frames > test[-1] + gap)]
        if len(train) < 2:
            raise UserError(f"{count} frames in {blocks} blocks with a gap of {gap} leave none to learn from")
        splits.append((train, test))
    return splits


def predictions(
    config: RecordingConfig,
    recording: Recording,
    splits: list[tuple[Indices, Indices]],
    on_block: OnBlock = lambda done, total: None,
) -> dict[str, Float[np.ndarray, " n"]]:
    """Returns what each method answers for every frame when it has not learned from the frame's block."""
    steering = recording.steering
    answers = {name: np.full(len(steering), np.nan) for name in ("network", "linear", "constant")}
    for number, (train, test) in enumerate(splits):
        on_block(number, len(splits))
        answers["constant"][test] = steering[train].mean()
        answers["linear"][test] = linear_answers(config, recording, train, test)
        answers["network"][test] = network_answers(config, recording, train, test, config.seed * 1009 + number * 101)
    on_block(len(splits), len(splits))
    return answers


def network_answers(
    config: RecordingConfig, recording: Recording, train: Indices, test: Indices, seed: int
) -> Float[np.ndarray, " _"]:
    """Trains the paper's network (L1) on some frames and returns what it answers for others."""
    pictures, steering = recording.pictures[train], torch.from_numpy(recording.steering[train]).float()
    if config.mirror:
        pictures, steering = torch.cat([pictures, mirrored(pictures)]), torch.cat([steering, -steering])
    network = train_network(config.task, pictures, steering[:, None], "l1", seed)
    with torch.no_grad():
        parts = [network(as_input(part))[:, 0] for part in recording.pictures[test].split(256)]
    return torch.cat(parts).double().numpy().clip(-1, 1)


def linear_answers(config: RecordingConfig, recording: Recording, train: Indices, test: Indices) -> np.ndarray:
    """Answers of ridge regression on small pictures; blocks of the training frames choose its strength."""
    known, asked = recording.pictures[train], recording.pictures[test]
    pixels, steering = small_pixels(known), recording.steering[train]
    inner = block_splits(len(train), max(config.blocks - 1, 2), min(config.gap, len(train) // 8))
    if config.mirror:
        pixels, steering = (
            np.concatenate([pixels, small_pixels(mirrored(known))]),
            np.concatenate([steering, -steering]),
        )
        inner = [(np.concatenate([rows, rows + len(train)]), held) for rows, held in inner]
    model = make_pipeline(StandardScaler(), RidgeCV(STRENGTHS, cv=inner)).fit(pixels, steering)
    return model.predict(small_pixels(asked)).clip(-1, 1)


def mirrored(pictures: UInt8[Tensor, "n h w 3"]) -> UInt8[Tensor, "n h w 3"]:
    """Returns pictures with left and right exchanged."""
    return pictures.flip(2)


def small_pixels(pictures: UInt8[Tensor, "n h w 3"]) -> Float[np.ndarray, "n values"]:
    """Returns the pixels of pictures of `LINEAR_WIDTH`, 0 to 1."""
    height = max(1, round(pictures.shape[1] * LINEAR_WIDTH / pictures.shape[2]))
    small = torch.nn.functional.interpolate(as_input(pictures), size=(height, LINEAR_WIDTH), mode="area")
    return small.flatten(1).double().numpy()


def explained(truth: Float[np.ndarray, " n"], answer: Float[np.ndarray, " n"]) -> float:
    """Share of the variance of `truth` that `answer` explains (R2); below 0 where its mean would do better."""
    spread = float(((truth - truth.mean()) ** 2).sum())
    error = float(((truth - answer) ** 2).sum())
    if spread == 0:
        return 1.0 if error == 0 else 0.0
    return 1 - error / spread
