"""Every test runs on one thread and from the same seeds, so that a failure repeats; no test is judged by its speed."""

import pytest
import torch
from hypothesis import HealthCheck, settings

from hashnerf.random_state import seed_everything

torch.set_num_threads(1)
settings.register_profile("house", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("house")


@pytest.fixture(autouse=True)
def seeded() -> None:
    """Start each test from the same random numbers, whatever ran before it."""
    seed_everything(0)
