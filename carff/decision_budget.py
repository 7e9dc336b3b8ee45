"""How many futures a decision may sample within a time limit, on this machine, with this run."""

from collections.abc import Mapping

import torch

from carff.decisions import decide_from_pictures
from carff.model import CarffModel
from hashnerf.budget import best_within, p95_ms
from hashnerf.progress import say

SAMPLES: Mapping[str, int] = {"fast": 5, "balanced": 10}
"""Sampled futures of the presets; 35 decide no better than 10 (docs/results/speed_accuracy.md, decisions)."""
CALLS = 40


def samples_within(model: CarffModel, max_ms: float, presets: Mapping[str, int] = SAMPLES) -> int:
    """Returns how many futures the best preset samples whose decisions stay below a limit (ms), and says why.

    A decision is everything from a picture to go or stop; 95 % of them count. Raises UserError where no preset fits.
    """
    costs = {name: decision_p95_ms(model, samples) for name, samples in presets.items()}
    name, reason = best_within(costs, max_ms, "max_ms", "ms")
    say(f"{reason}: {presets[name]} sampled futures")
    return presets[name]


def decision_p95_ms(model: CarffModel, samples: int) -> float:
    """Returns the milliseconds that 95 % of the decisions from one picture of noise stay below."""
    cameras, generator = model.scene.cameras, torch.Generator().manual_seed(0)
    picture = torch.randint(256, (1, cameras.height, cameras.width, 3), generator=generator, dtype=torch.uint8)
    return p95_ms(lambda: decide_from_pictures(model, picture, model.config.planner, samples, generator), CALLS)
