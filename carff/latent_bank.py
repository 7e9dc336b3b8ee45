"""The posteriors of all training views, weighted by how well each one knows its state.

The NeRF and the probe learn from latents of a *state*. A view that cannot tell its state from another one (a hidden
actor gives equal pictures, hence equal posteriors) would teach a blend of both, so views are drawn in proportion to
their distinctness (`carff.beliefs.view_distinctness`). Where no view of a state is distinct, all count alike.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from carff.beliefs import Belief
from hashnerf.low_precision import without_autocast


@dataclass(frozen=True)
class LatentBank:
    """Posteriors, the state of each view, its weight (sums to 1 within a state), and one fixed sample each."""

    mean: Float[Tensor, "views d"]
    logvar: Float[Tensor, "views d"]
    state: Int[Tensor, " views"]
    weight: Float[Tensor, " views"]
    fixed: Float[Tensor, "views d"]

    @property
    def states(self) -> int:
        """Number of states."""
        return int(self.state.max()) + 1

    def draw(self, states: Int[Tensor, " n"], fresh_share: float, generator: torch.Generator) -> Float[Tensor, "n d"]:
        """Draws a latent per requested state: a fresh sample with probability `fresh_share`, else the fixed one.

        A Bernoulli choice keeps every draw a draw from the posterior; a convex blend of two samples is not one
        (CARFF B.3 "slowly introduce the re-sampled latents").
        """
        per_state = torch.zeros(self.states, len(self.state))
        per_state[self.state, torch.arange(len(self.state))] = self.weight
        view = torch.multinomial(per_state[states], 1, generator=generator)[:, 0]
        noise = torch.randn(len(states), self.mean.shape[1], generator=generator)
        fresh = self.mean[view] + (0.5 * self.logvar[view]).exp() * noise
        use_fresh = torch.rand(len(states), 1, generator=generator) < fresh_share
        return torch.where(use_fresh, fresh, self.fixed[view])

    @without_autocast
    def state_beliefs(self) -> Belief:
        """Returns one Gaussian per state: the moments of the weighted mixture of its views' posteriors."""
        per_state = torch.zeros(self.states, len(self.state))
        per_state[self.state, torch.arange(len(self.state))] = self.weight
        mean = per_state @ self.mean
        spread = (self.mean - mean[self.state]).square() + self.logvar.exp()
        return Belief(mean, (per_state @ spread).log())


def build_bank(
    mean: Float[Tensor, "views d"],
    logvar: Float[Tensor, "views d"],
    state: Int[Tensor, " views"],
    distinctness: Float[Tensor, " views"],
    generator: torch.Generator,
) -> LatentBank:
    """Builds the bank from posteriors and each view's distinctness in [0, 1]."""
    states = int(state.max()) + 1
    weight = distinctness.clone()
    for s in range(states):
        own = state == s
        total = weight[own].sum()
        weight[own] = weight[own] / total if total > 1e-6 else 1.0 / int(own.sum())
    noise = torch.randn(mean.shape, generator=generator)
    return LatentBank(mean, logvar, state, weight, mean + (0.5 * logvar).exp() * noise)
