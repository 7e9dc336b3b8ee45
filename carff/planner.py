"""From sampled futures to a decision: go, or stop (CARFF 4.3).

Each of n sampled futures was probed: it shows a hazard, it is clear, or the probe could not tell (*unknown*). Costs are
in any one unit; only their ratio matters.

The exact sums below hold for n independent draws of the future. The programs draw systematically
(`GaussianMixture.sample`), which spreads less; how often they err is measured by `scripts/evaluate_carff.py`.

`paper`  go only if no sample counts as a hazard. One false alarm in n stops the car, so more samples mean more needless
         stops: at 0.5 % false alarms 4.9 % of clear scenes stop for n = 10, 16 % for n = 35.
`risk`   the hazard probability p has a Beta(prior_hazard, prior_clear) prior; n samples of which k count as hazards
         turn its mean into (prior_hazard + k) / (prior_hazard + prior_clear + n). Going costs p * collision_cost,
         stopping costs (1 - p) * stop_cost, as it is needless where there was no hazard. Go if going is cheaper, that
         is if p < stop_cost / (stop_cost + collision_cost). The allowed k grows with n, so more samples help.
         The defaults allow k = 0 from n = 2, 1 from n = 9, 2 from n = 16, 4 at n = 35; one sample never suffices.
         At n = 10 no rule on counts does better: k = 0 stops 4.9 % of clear scenes, k = 2 goes in 5.5 % of hidden ones.
`always_stop` and `always_go` are the paper's under-confident and over-confident baselines.
"""

import math
from dataclasses import dataclass
from typing import Literal

from jaxtyping import Bool
from torch import Tensor

from hashnerf.errors import UserError


@dataclass(frozen=True)
class PlannerConfig:
    """How sampled futures become a decision."""

    rule: Literal["paper", "risk", "always_stop", "always_go"] = "risk"
    """`paper`: go only if every sample is clear; `risk`: go if that has the lower expected cost; or a baseline."""
    collision_cost: float = 6.0
    """Cost of going where there is a hazard."""
    stop_cost: float = 1.0
    """Cost of stopping where there is none."""
    prior_hazard: float = 0.5
    """Hazardous futures believed seen before the first sample (alpha of the Beta prior)."""
    prior_clear: float = 1.5
    """Clear futures believed seen before the first sample (beta of the Beta prior)."""
    unknown_weight: float = 1.0
    """How much of a hazard a sample counts whose state the probe could not tell (1: a hazard, 0: clear)."""

    def __post_init__(self):
        for name in ("collision_cost", "stop_cost", "prior_hazard", "prior_clear"):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                raise UserError(f"planner.{name} is {value}; give a positive number")
        if not 0 <= self.unknown_weight <= 1:
            raise UserError(f"planner.unknown_weight is {self.unknown_weight}; give a number from 0 to 1")

    @property
    def acceptable_risk(self) -> float:
        """The hazard probability below which going costs less than stopping."""
        return self.stop_cost / (self.stop_cost + self.collision_cost)


@dataclass(frozen=True)
class Decision:
    """What to do, and the numbers it rests on."""

    go: bool
    samples: int
    hazards: int
    unknown: int
    hazard_probability: float
    """Posterior mean of the hazard probability (whatever the rule)."""
    cost_of_going: float
    cost_of_stopping: float


def decide(hazard: Bool[Tensor, " n"], unknown: Bool[Tensor, " n"], config: PlannerConfig) -> Decision:
    """Returns the decision for n sampled futures; raises UserError without samples, or if one is hazard and unknown."""
    if len(hazard) == 0:
        raise UserError("a decision needs at least one sampled future")
    if (hazard & unknown).any():
        raise UserError("a sampled future cannot be a known hazard and unknown at once")
    hazards, unclear, count = int(hazard.sum()), int(unknown.sum()), len(hazard)
    weight = hazards + config.unknown_weight * unclear
    probability = _hazard_probability(weight, count, config)
    return Decision(
        go=_goes(weight, count, config),
        samples=count,
        hazards=hazards,
        unknown=unclear,
        hazard_probability=probability,
        cost_of_going=probability * config.collision_cost,
        cost_of_stopping=(1 - probability) * config.stop_cost,
    )


def _hazard_probability(weight: float, count: int, config: PlannerConfig) -> float:
    return (config.prior_hazard + weight) / (config.prior_hazard + config.prior_clear + count)


def _goes(weight: float, count: int, config: PlannerConfig) -> bool:
    if config.rule == "always_go":
        return True
    if config.rule == "always_stop":
        return False
    if config.rule == "paper":
        return weight == 0
    return _hazard_probability(weight, count, config) < config.acceptable_risk


def exact_go_probability(config: PlannerConfig, n: int, hazard_probability: float) -> float:
    """Returns the probability of going when each of n samples shows a hazard with the given probability, all known."""
    if n < 1 or not 0 <= hazard_probability <= 1:
        raise UserError(f"n = {n} samples with hazard probability {hazard_probability}: n >= 1, probability in [0, 1]")
    p = hazard_probability
    return math.fsum(math.comb(n, k) * p**k * (1 - p) ** (n - k) for k in range(n + 1) if _goes(float(k), n, config))


def exact_success(config: PlannerConfig, n: int, hazard_probability: float, safe_to_go: bool) -> float:
    """Returns the probability of the right decision: going where it is safe, stopping where it is not.

    CARFF Table 3 holds 30 draws of this number a cell. An occluded view of a two-branch scene has a hazard probability
    of about one half; a view that shows the way to be clear has the rate of false alarms.
    """
    go = exact_go_probability(config, n, hazard_probability)
    return go if safe_to_go else 1 - go
