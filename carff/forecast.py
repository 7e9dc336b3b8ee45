"""Roll-out of beliefs: image belief -> mixture over the next latents -> samples -> probed states -> again (CARFF 3.2).

Each of `n` samples follows its own future. Probing tells the state that a sampled latent describes; that state's belief
is what the forecast network reads for the following step (appendix C, "probe and predict"). A sample whose state is
unknown keeps its own place: its belief is the mixture component's spread around the sample.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from carff.beliefs import Belief
from carff.mixtures import GaussianMixture
from carff.probe import UNKNOWN, DensityFn, Probe

MixtureFn = Callable[[Float[Tensor, "b d"], Float[Tensor, "b d"]], GaussianMixture]


@dataclass(frozen=True)
class Forecast:
    """What is believed about the next steps; row 0 of the first axis is one step ahead."""

    mixture: GaussianMixture
    """The predicted mixture one step ahead (batch of 1)."""
    latents: Float[Tensor, "ahead n d"]
    scores: Float[Tensor, "ahead n boxes"]
    states: Int[Tensor, "ahead n"]
    """State of every sample, -1 where unknown."""


@torch.no_grad()
def roll_out(
    belief: Belief,
    mdn: MixtureFn,
    probe: Probe,
    density_fn: DensityFn,
    state_beliefs: Belief,
    n: int,
    ahead: int,
    generator: torch.Generator,
) -> Forecast:
    """Forecasts `ahead` steps from one belief (mean [1, d]) with `n` samples (CARFF Eq. 4, 5)."""
    first = mdn(belief.mean, belief.logvar)
    mixture = first
    rows: list[tuple[Tensor, Tensor, Tensor]] = []
    for step in range(ahead):
        count = n if step == 0 else 1
        latents = mixture.sample(count, generator).reshape(n, -1)
        scores = probe.scores(latents, density_fn)
        states = probe.classify(scores)
        rows.append((latents, scores, states))
        known = (states != UNKNOWN)[:, None]
        spread = mixture.variance().log().expand(n, -1)
        mean = torch.where(known, state_beliefs.mean[states], latents)
        logvar = torch.where(known, state_beliefs.logvar[states], spread)
        if step + 1 < ahead:
            mixture = mdn(mean, logvar)
    latents, scores, states = (torch.stack(parts) for parts in zip(*rows))
    return Forecast(first, latents, scores, states)
