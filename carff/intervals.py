"""How sure a measured number is: intervals for proportions and curves, and how honest probabilities are."""

import math
from dataclasses import dataclass
from statistics import NormalDist

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from hashnerf.errors import UserError


def wilson_interval(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Returns the Wilson score interval of a proportion; (0, 1) without trials. Raises UserError if impossible."""
    if not 0 <= successes <= trials:
        raise UserError(f"{successes} successes of {trials} trials is impossible")
    z = _two_sided_quantile(confidence)
    if trials == 0:
        return 0.0, 1.0
    share = successes / trials
    centre = share + z * z / (2 * trials)
    spread = z * math.sqrt(share * (1 - share) / trials + z * z / (4 * trials * trials))
    scale = 1 + z * z / trials
    # The ends are exact at 0 and at `trials`, where rounding would leave 1e-17.
    low = 0.0 if successes == 0 else (centre - spread) / scale
    high = 1.0 if successes == trials else (centre + spread) / scale
    return low, high


def _two_sided_quantile(confidence: float) -> float:
    if not 0 < confidence < 1:
        raise UserError(f"confidence is {confidence}; give a number between 0 and 1, such as 0.95")
    return NormalDist().inv_cdf(0.5 + confidence / 2)


def bootstrap_band(
    curves: Float[Tensor, "repeats points"],
    confidence: float = 0.95,
    resamples: int = 1000,
    generator: torch.Generator | None = None,
) -> tuple[Float[Tensor, " points"], Float[Tensor, " points"]]:
    """Returns the lower and upper percentile band of the mean curve, resampling whole curves with replacement."""
    _two_sided_quantile(confidence)
    repeats = len(curves)
    if repeats == 0:
        raise UserError("a band needs at least one curve")
    pick = torch.randint(repeats, (resamples, repeats), generator=generator).to(curves.device)
    counts = torch.zeros(resamples, repeats, dtype=curves.dtype, device=curves.device)
    counts.scatter_add_(1, pick, torch.ones_like(counts))
    means = counts @ curves / repeats
    tail = (1 - confidence) / 2
    low, high = torch.quantile(means, torch.tensor([tail, 1 - tail], dtype=means.dtype, device=means.device), dim=0)
    return low, high


@dataclass(frozen=True)
class ReliabilityBin:
    """Predictions of about the same probability, and how often they came true."""

    count: int
    mean_probability: float
    frequency: float
    low: float
    high: float


def reliability_table(
    probabilities: Float[Tensor, " n"], outcomes: Bool[Tensor, " n"], bins: int = 10, equal_count: bool = False
) -> tuple[ReliabilityBin, ...]:
    """Returns the non-empty bins of a reliability diagram with 95 % Wilson intervals of the frequency.

    Bins have equal width, or with `equal_count` about the same number of predictions each (equal probabilities share a
    bin).
    """
    if bins < 1:
        raise UserError(f"bins is {bins}; give at least 1")
    if not ((probabilities >= 0) & (probabilities <= 1)).all():
        raise UserError("a reliability table needs probabilities between 0 and 1")
    probabilities = probabilities.double()
    if equal_count:
        below = torch.searchsorted(probabilities.sort().values, probabilities)  # predictions strictly below each
        index = below * bins // max(len(probabilities), 1)
    else:
        index = (probabilities * bins).long().clamp(max=bins - 1)
    return tuple(_bin(probabilities[index == i], outcomes[index == i]) for i in range(bins) if (index == i).any())


def _bin(probabilities: Float[Tensor, " n"], outcomes: Bool[Tensor, " n"]) -> ReliabilityBin:
    hits, count = int(outcomes.sum()), len(outcomes)
    return ReliabilityBin(count, float(probabilities.mean()), hits / count, *wilson_interval(hits, count))


def expected_calibration_error(
    probabilities: Float[Tensor, " n"], outcomes: Bool[Tensor, " n"], bins: int = 10, equal_count: bool = False
) -> float:
    """Returns the mean gap between predicted probability and observed frequency, weighted by bin size."""
    if len(probabilities) == 0:
        raise UserError("the calibration error of no predictions is not defined")
    table = reliability_table(probabilities, outcomes, bins, equal_count)
    return sum(entry.count * abs(entry.mean_probability - entry.frequency) for entry in table) / len(probabilities)
