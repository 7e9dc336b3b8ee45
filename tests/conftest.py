"""Every test runs on one thread and from the same seeds, so that a failure repeats."""

import pytest
import torch

from hashnerf.random_state import seed_everything

torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def seeded() -> None:
    """Start each test from the same random numbers, whatever ran before it."""
    seed_everything(0)
