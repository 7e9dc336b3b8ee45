"""From pictures to decisions: encode, forecast n next states, probe them, apply the planner's rule.

A forecast knows no state beyond the last one of a branch: what it says there was never trained. Where most sampled
presents of a picture are such last states, each of these therefore stands for its own future. The other samples, and
pictures with fewer of them, are left to the forecast: a picture that fits several steps gives presents half-way between
their states, in which the probe sees the ghosts of all, and the forecast was trained on such pictures. Decisions draw
the n next scenes systematically over the mixture's components: with independent draws, 10 futures of a hazard of
probability 1/3 show none or one of it in 10 % of all cases, which is noise of the sampling and not knowledge.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from carff.beliefs import Belief, sample_beliefs
from carff.model import CarffModel
from carff.planner import Decision, PlannerConfig, decide
from carff.probe import UNKNOWN

RuleOut = Callable[[int, Float[Tensor, "n states"]], Bool[Tensor, " n"]]


@torch.no_grad()
def sample_next_scores(
    model: CarffModel, belief: Belief, n: int, generator: torch.Generator, systematic: bool = False
) -> Float[Tensor, "beliefs {n} boxes"]:
    """Returns how occupied every candidate box is in `n` sampled next scenes per belief."""
    latents = model.mdn(belief.mean, belief.logvar).sample(n, generator, systematic)
    return model.probe_scores(latents.flatten(0, 1)).reshape(len(belief), n, -1)


@dataclass(frozen=True)
class SampledScenes:
    """How occupied every candidate box is in sampled scenes."""

    present: Float[Tensor, "beliefs n boxes"]
    """The scene that a belief is about."""
    future: Float[Tensor, "beliefs n boxes"]
    """What to decide by: the next scene, or the present one where that is the last."""


@torch.no_grad()
def sample_scenes(model: CarffModel, belief: Belief, n: int, generator: torch.Generator) -> SampledScenes:
    """Probes `n` sampled presents and futures of each belief."""
    ahead = sample_next_scores(model, belief, n, generator, systematic=True)
    present = model.probe_scores(sample_beliefs(belief, n, generator).flatten(0, 1))
    states = model.probe.classify(present)
    last = ((states != UNKNOWN) & (model.scene.successor[states.clamp(min=0)] < 0)).reshape(len(belief), n)
    stays = last & (last.float().mean(dim=1, keepdim=True) > 0.5)
    present = present.reshape(ahead.shape)
    return SampledScenes(present, torch.where(stays[:, :, None], present, ahead))


def decide_from_pictures(
    model: CarffModel,
    pictures: UInt8[Tensor, "images h w 3"],
    planner: PlannerConfig,
    n: int,
    generator: torch.Generator,
    rule_out: RuleOut | None = None,
) -> list[Decision]:
    """Returns one decision per picture, each from `n` sampled futures of its own.

    `rule_out` tells from a picture's number and the state posteriors of its sampled presents which of them cannot be;
    the futures drawn beside those count as unknown, unless they are hazards.
    """
    decisions = []
    scenes = sample_scenes(model, model.encode(pictures), n, generator)
    for number, (present, future) in enumerate(zip(scenes.present, scenes.future)):
        hazard, unknown = model.hazards(future)
        if rule_out is not None:
            unknown |= rule_out(number, model.probe.state_posterior(present)) & ~hazard
        decisions.append(decide(hazard, unknown, planner))
    return decisions
