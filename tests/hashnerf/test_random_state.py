"""Random streams: seeded alike, different for different seeds, and continued at the very next draw."""

import json
import random

import numpy as np
import pytest
import torch

from hashnerf.checkpoints import load_checkpoint, pack, save_checkpoint, unpack
from hashnerf.errors import UserError
from hashnerf.random_state import capture_random_state, restore_random_state, seed_everything


def draws(generator: torch.Generator) -> list[float]:
    """One number of every stream; the Gaussian ones keep a spare value inside, which must be captured too."""
    return [
        random.random(),
        random.gauss(0, 1),
        np.random.rand(),
        np.random.standard_normal(),
        torch.rand(1).item(),
        torch.randn(3)[2].item(),
        torch.randn(1, generator=generator).item(),
    ]


@pytest.mark.parametrize("warm_up", [0, 1, 2, 313, 625])  # 624 words make one Mersenne Twister block
def test_every_stream_continues_exactly_through_a_checkpoint(tmp_path, warm_up):
    seed_everything(3)
    generator = torch.Generator().manual_seed(5)
    for _ in range(warm_up):
        draws(generator)
    state = capture_random_state({"rays": generator})
    # Drawn before anything is saved: the type checker that is live in tests takes numbers from Python's `random`.
    expected = [draws(generator) for _ in range(5)]
    tensors: dict[str, torch.Tensor] = {}
    tree = pack(state, "random", tensors)
    save_checkpoint(tmp_path, 1, tensors, json.loads(json.dumps(tree)))

    seed_everything(99)
    other = torch.Generator().manual_seed(98)
    assert draws(other) != expected[0]
    loaded = load_checkpoint(tmp_path)
    restore_random_state(unpack(loaded.state, loaded.tensors), {"rays": other})
    assert [draws(other) for _ in range(5)] == expected


def test_capturing_draws_nothing():
    seed_everything(1)
    generator = torch.Generator().manual_seed(1)
    first = draws(generator)
    seed_everything(1)
    generator.manual_seed(1)
    capture_random_state({"g": generator})
    assert draws(generator) == first


def test_k26_seeds_decide_every_global_stream(numeric_row):
    def streams(seed: int) -> list[float]:
        seed_everything(seed)
        return [random.random(), np.random.rand(), torch.rand(1).item()]

    different = sum(a != b for a, b in zip(streams(7), streams(7)))
    numeric_row("K26", "Python, NumPy, torch from one seed: streams that differ", different)
    numeric_row(
        "K26", "the same from two seeds: streams that are equal", sum(map(float.__eq__, streams(7), streams(8)))
    )


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_seeds_outside_the_range_are_refused(seed):
    with pytest.raises(UserError, match=f"seed = {seed}"):
        seed_everything(seed)
    seed_everything(2**32 - 1)


def test_other_generators_than_the_saved_ones_are_refused():
    state = capture_random_state({"rays": torch.Generator()})
    with pytest.raises(UserError, match=r"\['rays'\].*\['poses'\]"):
        restore_random_state(state, {"poses": torch.Generator()})
    with pytest.raises(UserError, match=r"\['rays'\].*\[\]"):
        restore_random_state(state)
