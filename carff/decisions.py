"""From pictures to decisions: encode, forecast n next states, probe them, apply the planner's rule."""

import torch
from jaxtyping import Int, UInt8
from torch import Tensor

from carff.beliefs import Belief
from carff.model import CarffModel
from carff.planner import Decision, PlannerConfig, decide


@torch.no_grad()
def sample_next_states(
    model: CarffModel, belief: Belief, n: int, generator: torch.Generator
) -> Int[Tensor, "beliefs {n}"]:
    """Returns the probed states of `n` sampled next scenes per belief, -1 where the probe could not tell."""
    latents = model.mdn(belief.mean, belief.logvar).sample(n, generator)
    return model.probe_latents(latents.flatten(0, 1)).reshape(len(belief), n)


def decide_from_pictures(
    model: CarffModel,
    pictures: UInt8[Tensor, "images h w 3"],
    planner: PlannerConfig,
    n: int,
    generator: torch.Generator,
) -> list[Decision]:
    """Returns one decision per picture, each from `n` sampled futures of its own."""
    states = sample_next_states(model, model.encode(pictures), n, generator)
    return [decide(*model.hazards(row), planner) for row in states]
