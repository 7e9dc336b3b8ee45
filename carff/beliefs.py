"""Beliefs: diagonal Gaussians over scene latents, and what may be computed from them without overflow.

A belief has a `mean` and a `logvar` (natural log of the variance, never the variance). Everything runs in float32 or
better, whatever the autocast state. Log-variances are bounded to [-12, 8]: exp stays finite with room for its square
and its gradient.
"""

import logging
import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from carff.states import connected_groups
from hashnerf.errors import UserError

LOGVAR_BOUNDS = (-12.0, 8.0)  # standard deviations 0.0025 to 55
LARGEST_LATENT = 1e6  # beyond it a squared distance in units of the smallest sigma nears the end of float32

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Belief:
    """n diagonal Gaussians over d latent dimensions."""

    mean: Float[Tensor, "n d"]
    logvar: Float[Tensor, "n d"]

    def __len__(self) -> int:
        return len(self.mean)

    def select(self, index: Int[Tensor, " m"] | Bool[Tensor, " n"] | slice) -> "Belief":
        """Returns the beliefs at `index`."""
        return Belief(self.mean[index], self.logvar[index])

    def to(self, device: torch.device | str) -> "Belief":
        """Returns the beliefs on a device."""
        return Belief(self.mean.to(device), self.logvar.to(device))


def at_least_float32(values: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Returns half-precision values as float32 and leaves the others alone."""
    return values.float() if values.dtype in (torch.float16, torch.bfloat16) else values


def soft_bound(raw: Float[Tensor, "*shape"], low: float, high: float) -> Float[Tensor, "*shape"]:
    """Returns `raw`, bent into (low, high) within 1 of either bound and untouched between.

    Beyond the bend the distance to the bound falls as 1/x, the gradient as 1/x^2. A softplus or sigmoid bound is flat
    to the last bit a few units out (gradient 1e-32 at 80): a value thrown there by one bad step never comes back. Here
    Adam still sees the way home.
    """
    raw = at_least_float32(raw)
    over = torch.relu(raw - (high - 1))
    under = torch.relu((low + 1) - raw)
    return raw.clamp(low + 1, high - 1) + (1 - 1 / (1 + over)) - (1 - 1 / (1 + under))


def bound_logvar(raw: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Returns raw network outputs as log-variances in [-12, 8] (the identity on [-11, 7])."""
    return soft_bound(raw, *LOGVAR_BOUNDS)


def require_latents(values: Float[Tensor, "n *rest"], what: str) -> None:
    """Raises UserError naming the first of n rows that is not finite or exceeds 1e6 in size."""
    bad = ~(values.abs() <= LARGEST_LATENT).reshape(len(values), -1).all(dim=1)
    if bad.any():
        row = int(bad.nonzero()[0])
        raise UserError(
            f"{what}: row {row} of {len(values)} is not finite or larger than {LARGEST_LATENT:.0e}; "
            "train the encoder again with a lower learning rate"
        )


def kl_per_dimension(belief: Belief) -> Float[Tensor, "n d"]:
    """Returns the KL divergence to a standard normal, dimension by dimension, in nats (>= 0).

    exp(l) - 1 - l cancels near l = 0: it came out negative in float32 already at l = -1e-4. A series takes over there.
    """
    mean, logvar = at_least_float32(belief.mean), at_least_float32(belief.logvar)
    small = logvar.abs() < 1e-2
    series = logvar.clamp(-1e-2, 1e-2)
    series = series * series * (0.5 + series * (1 / 6 + series * (1 / 24 + series / 120)))
    # The argument of the unused branch is replaced, so that its infinite gradient cannot reach the result as 0 * inf.
    wide = logvar.masked_fill(small, 1.0)
    return 0.5 * (mean.square() + torch.where(small, series, torch.expm1(wide) - wide))


def kl_to_standard_normal(belief: Belief) -> Float[Tensor, " n"]:
    """Returns the KL divergence to a standard normal, summed over latent dimensions, in nats.  # CARFF Eq. 2"""
    return kl_per_dimension(belief).sum(dim=-1)


def reparameterise(belief: Belief, generator: torch.Generator | None = None) -> Float[Tensor, "n d"]:
    """Returns one sample of each belief, differentiable in mean and log-variance."""
    return sample_beliefs(belief, 1, generator)[:, 0]


def sample_beliefs(belief: Belief, count: int, generator: torch.Generator | None = None) -> Float[Tensor, "n count d"]:
    """Returns `count` samples of each belief, differentiable in mean and log-variance."""
    mean, logvar = at_least_float32(belief.mean), at_least_float32(belief.logvar)
    noise = torch.randn(len(mean), count, mean.shape[1], generator=generator, device=mean.device, dtype=mean.dtype)
    return mean[:, None] + torch.exp(0.5 * logvar)[:, None] * noise


def log_bhattacharyya(
    mean_a: Float[Tensor, "*shape d"],
    logvar_a: Float[Tensor, "*shape d"],
    mean_b: Float[Tensor, "*shape d"],
    logvar_b: Float[Tensor, "*shape d"],
) -> Float[Tensor, "*shape"]:
    """Returns the log of the overlap integral of sqrt(p q) of two diagonal Gaussians (<= 0), in closed form.

    Per dimension: -(difference of means)^2 / (4 (va + vb)) - log cosh((la - lb) / 2) / 2.
    """
    mean_a, logvar_a = at_least_float32(mean_a), at_least_float32(logvar_a)
    mean_b, logvar_b = at_least_float32(mean_b), at_least_float32(logvar_b)
    distance = (mean_a - mean_b) * torch.exp(-0.5 * torch.logaddexp(logvar_a, logvar_b))
    half = 0.5 * (logvar_a - logvar_b).abs()
    log_cosh = half + torch.log1p(torch.exp(-2 * half)) - math.log(2)
    return (-0.25 * distance.square() - 0.5 * log_cosh).sum(dim=-1).clamp(max=0)


def bhattacharyya_coefficient(belief_a: Belief, belief_b: Belief) -> Float[Tensor, " n"]:
    """Returns the overlap of two rows of beliefs: 1 for equal Gaussians, towards 0 as they part."""
    return log_bhattacharyya(belief_a.mean, belief_a.logvar, belief_b.mean, belief_b.logvar).exp()


def active_units(means: Float[Tensor, "n d"], threshold: float = 0.01) -> Bool[Tensor, " d"]:
    """Returns which latent dimensions vary over the data: variance of the posterior mean above `threshold`.

    Logs a warning when none does: the decoder ignores the latent (posterior collapse) and nothing after it can work.
    """
    active = at_least_float32(means).var(dim=0, correction=0) > threshold
    if not active.any():
        log.warning("no latent dimension varies over the data: the posterior has collapsed; lower the KL weight")
    return active


def _overlaps(
    means: Float[Tensor, "states cameras d"],
    logvars: Float[Tensor, "states cameras d"],
    valid: Bool[Tensor, "states cameras"],
) -> tuple[Float[Tensor, "states states cameras"], Bool[Tensor, "states states cameras"]]:
    """Returns the overlap of every two states at every camera, and where both have a view."""
    rows = [
        log_bhattacharyya(*torch.broadcast_tensors(mean[None], logvar[None], means, logvars)).exp()
        for mean, logvar in zip(means, logvars)
    ]
    return torch.stack(rows), valid[:, None] & valid[None, :]


def indistinguishable_states(
    means: Float[Tensor, "states cameras d"],
    logvars: Float[Tensor, "states cameras d"],
    valid: Bool[Tensor, "states cameras"],
    tolerance: float = 1e-3,
) -> Int[Tensor, " states"]:
    """Returns a group number per state: together are states that no common camera tells apart by more than `tolerance`.

    A first state that two branches share is such a group: it is one situation under two names. States without a common
    camera stay apart.
    """
    overlap, both = _overlaps(means, logvars, valid)
    same = both.any(dim=2) & ((1 - overlap <= tolerance) | ~both).all(dim=2)
    return connected_groups(same)


def view_distinctness(
    means: Float[Tensor, "states cameras d"],
    logvars: Float[Tensor, "states cameras d"],
    valid: Bool[Tensor, "states cameras"],
    tolerance: float = 1e-3,
) -> Float[Tensor, "states cameras"]:
    """Returns 1 - the largest overlap with another state seen from the same camera; 0 where the view is missing.

    0: the camera cannot tell this state from some other one (equal pictures give equal beliefs). 1: it can. States that
    no camera tells apart are left out of the maximum, as they would silence every camera. No branch label enters.
    """
    overlap, both = _overlaps(means, logvars, valid)
    group = indistinguishable_states(means, logvars, valid, tolerance)
    rival = both & (group[:, None] != group[None, :])[:, :, None]
    return (1 - overlap.masked_fill(~rival, 0).amax(dim=1)).masked_fill(~valid, 0)
