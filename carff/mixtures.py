"""Mixtures of k diagonal Gaussians over d latent dimensions, one mixture a row (CARFF Eq. 5), in log-space throughout.

A weight is kept as its log, a standard deviation as its log, bounded to [-7, 7]; neither is ever exponentiated and
logged again. Everything runs in float32 or better, whatever the autocast state.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from carff.beliefs import at_least_float32, soft_bound

LOG_SIGMA_BOUNDS = (-7.0, 7.0)  # standard deviations 0.0009 to 1100, in whatever units the mixture has
HALF_LOG_TWO_PI = 0.5 * math.log(2 * math.pi)


@dataclass(frozen=True)
class GaussianMixture:
    """b mixtures of k diagonal Gaussians over d dimensions; the weights of a row sum to one."""

    log_weights: Float[Tensor, "b k"]
    means: Float[Tensor, "b k d"]
    log_sigmas: Float[Tensor, "b k d"]

    def __len__(self) -> int:
        return len(self.means)

    def component_log_prob(self, values: Float[Tensor, "b s d"]) -> Float[Tensor, "b s k"]:
        """Returns the log density of each value under each component, weights left out."""
        means, log_sigmas = self.means[:, None], self.log_sigmas[:, None]
        # Divide by sigma before squaring: a variance underflows where the standard deviation does not.
        z = (at_least_float32(values)[:, :, None] - means) * torch.exp(-log_sigmas)
        return -(0.5 * z.square() + log_sigmas + HALF_LOG_TWO_PI).sum(dim=-1)

    def log_prob(self, values: Float[Tensor, "b s d"]) -> Float[Tensor, "b s"]:
        """Returns the log density of each value."""
        return torch.logsumexp(self.log_weights[:, None] + self.component_log_prob(values), dim=-1)

    def sample(
        self, count: int, generator: torch.Generator | None = None, systematic: bool = False
    ) -> Float[Tensor, "b {count} d"]:
        """Returns `count` samples of each mixture; the same generator state gives the same samples.

        Of `systematic` samples, shuffled, each component gives as many as its weight says, to within one: every sample
        alone is still a draw from the mixture, but what fraction of them shows something is far less noisy.
        """
        rows, components, dimensions = self.means.shape
        options = {"generator": generator, "device": self.means.device, "dtype": self.means.dtype}
        if systematic:
            chosen = spread_components(self.log_weights, torch.rand(rows, 1, **options), count)
            chosen = chosen.gather(1, torch.rand(rows, count, **options).argsort(dim=1))
        else:
            chosen = choose_component(self.log_weights, torch.rand(rows, count, components, **options))
        index = chosen[:, :, None].expand(rows, count, dimensions)
        noise = torch.randn(rows, count, dimensions, **options)
        return self.means.gather(1, index) + torch.exp(self.log_sigmas.gather(1, index)) * noise

    def mean(self) -> Float[Tensor, "b d"]:
        """Returns the mean of each mixture."""
        return (self.log_weights.exp()[:, :, None] * self.means).sum(dim=1)

    def variance(self) -> Float[Tensor, "b d"]:
        """Returns the variance of each mixture per dimension: mean of the variances plus variance of the means."""
        weights = self.log_weights.exp()[:, :, None]
        spread = self.means - self.mean()[:, None]
        return (weights * (torch.exp(2 * self.log_sigmas) + spread.square())).sum(dim=1)


def mixture_from_raw(
    logits: Float[Tensor, "b k"],
    means: Float[Tensor, "b k d"],
    raw_log_sigmas: Float[Tensor, "b k d"],
    bounds: tuple[float, float] = LOG_SIGMA_BOUNDS,
) -> GaussianMixture:
    """Returns the mixture of raw network outputs: log-softmax weights and softly bounded log-sigmas."""
    log_weights = torch.log_softmax(at_least_float32(logits), dim=-1)
    return GaussianMixture(log_weights, at_least_float32(means), soft_bound(raw_log_sigmas, *bounds))


def choose_component(log_weights: Float[Tensor, "b k"], uniform: Float[Tensor, "b s k"]) -> Int[Tensor, "b s"]:
    """Returns component numbers drawn with the given weights from numbers uniform in [0, 1) (the Gumbel-max rule).

    A search in cumulated weights can fall off the end, because they sum to less than one in float32; a maximum cannot.
    """
    tiny = torch.finfo(uniform.dtype).tiny  # exactly 0 would make a live component look as dead as one of weight 0
    gumbel = -torch.log(-torch.log(uniform.clamp_min(tiny)))
    return (log_weights[:, None] + gumbel).argmax(dim=-1)


def spread_components(
    log_weights: Float[Tensor, "b k"], uniform: Float[Tensor, "b 1"], count: int
) -> Int[Tensor, "b {count}"]:
    """Returns component numbers drawn by systematic sampling from one number uniform in [0, 1) a row, sorted.

    A component of weight w comes floor(w count) or ceil(w count) times, w count times on average.
    """
    cumulative = log_weights.double().exp().cumsum(dim=1)
    places = torch.arange(count, dtype=torch.float64, device=log_weights.device)
    # in units of the last entry, which rounding may leave beside 1: no place lies beyond it
    wanted = (places + uniform.double()) / count * cumulative[:, -1:]
    chosen = torch.searchsorted(cumulative, wanted, right=True)
    last = (log_weights > -torch.inf).long().cumsum(dim=1).argmax(dim=1, keepdim=True)  # the last that has any weight
    return chosen.minimum(last)


def negative_log_likelihood(mixture: GaussianMixture, values: Float[Tensor, "b s d"]) -> Float[Tensor, ""]:
    """Returns the mean negative log density of the values, in nats per value.  # CARFF Eq. 6"""
    return -mixture.log_prob(values).mean()
