"""How often plans are right: the open-loop table of CARFF Table 3 and the closed-loop comparison of policies.

Notation: a *decision* is True for "go" and False for "wait"; `hazard` is True where going would be unsafe. A decision
succeeds when it waits at a hazard and goes when the way is clear. Rates are shares in [0, 1] with Wilson intervals; a
rate without trials is None. Trials on one image share that image's belief, so the interval over all trials says how
well *these* images are handled; `worst_image` beside it shows whether one image carries all the failures. Times are in
seconds.
"""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Bool

from carff.intervals import wilson_interval

ALWAYS_STOP, ALWAYS_GO = "always_stop", "always_go"
POLICY_LABELS = {
    ALWAYS_STOP: "always stop (under-confident)",
    ALWAYS_GO: "always go (over-confident)",
    "oracle": "all-seeing oracle",
    "risk": "risk rule",
    "paper": "paper rule",
}
# CARFF Table 3, 30 trials on one image of the authors' own data: (waits at a hazard, goes when clear).
PAPER_SUCCESS = {
    "intersection": {("paper", 2): (17 / 30, 1.0), ("paper", 10): (1.0, 1.0), ("paper", 35): (1.0, 19 / 30)},
    "two_lane_merge": {("paper", 2): (21 / 30, 1.0), ("paper", 10): (1.0, 1.0), ("paper", 35): (1.0, 22 / 30)},
}


@dataclass(frozen=True)
class Rate:
    """`successes` of `trials`, their share and its Wilson interval; None instead of numbers without trials."""

    successes: int
    trials: int
    share: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True)
class PlanRow:
    """One row of the planning table."""

    rule: str
    n: int | None
    """Sampled futures a decision; None for the baselines, which look at nothing."""
    hazard: Rate
    clear: Rate
    worst_hazard_image: float | None
    worst_clear_image: float | None
    """Lowest success share of a single image."""


@dataclass(frozen=True)
class Episode:
    """One drive of one policy through the closed-loop world."""

    policy: str
    branch: int
    hazard: bool
    """Whether crossing without any stop would have met another actor."""
    collided: bool
    stopped: bool
    needless_stop: bool
    """Stopped although the way was clear."""
    time_to_cross: float | None
    """Seconds from the start to the far side; None where the far side was not reached."""
    decisions: int


@dataclass(frozen=True)
class ApproachPoint:
    """A picture that the ego's camera takes on the approach, and what is decided from it alone."""

    branch: int
    step: int
    to_line: float
    """Metres that the ego still has to the stop line."""
    kind: str
    """`hidden`, `shown` or `clear` (`carff.picture_kinds`); `other` has no single right decision."""
    hazard_share: float
    """Share of the sampled futures that show a hazard or could not be told."""
    go: bool


def policy_label(policy: str, n: int | None = None) -> str:
    """How a policy or rule, with its number of samples, is called in figures and tables."""
    label = POLICY_LABELS.get(policy, policy.replace("_", " "))
    return label if n is None else f"{label}, n = {n}"


def rate(successes: int, trials: int, confidence: float = 0.95) -> Rate:
    """A share with its Wilson interval; None everywhere for zero trials."""
    if trials == 0:
        return Rate(0, 0, None, None, None)
    low, high = wilson_interval(successes, trials, confidence)
    return Rate(successes, trials, successes / trials, float(low), float(high))


def planning_table(
    decisions: Mapping[tuple[str, int], Bool[np.ndarray, "images trials"]], hazard: Bool[np.ndarray, " images"]
) -> list[PlanRow]:
    """Rows like CARFF Table 3: both baselines, then every (rule, n) of `decisions`, True meaning go."""
    trials = max((go.shape[1] for go in decisions.values()), default=1)
    baselines = {
        (ALWAYS_STOP, None): np.zeros((len(hazard), trials), dtype=bool),
        (ALWAYS_GO, None): np.ones((len(hazard), trials), dtype=bool),
    }
    return [_row(rule, n, go, hazard) for (rule, n), go in (baselines | dict(decisions)).items()]


def plan_results(rows: Iterable[PlanRow]) -> dict:
    """The table as nested keys, such as `risk.n10.hazard_success` and `always_stop.clear_interval`."""
    results: dict = {}
    for row in rows:
        place = results.setdefault(row.rule, {})
        if row.n is not None:
            place = place.setdefault(f"n{row.n}", {})
        for name, value, worst in (
            ("hazard", row.hazard, row.worst_hazard_image),
            ("clear", row.clear, row.worst_clear_image),
        ):
            place[f"{name}_success"] = value.share
            place[f"{name}_count"] = [value.successes, value.trials]
            place[f"{name}_interval"] = None if value.share is None else [value.low, value.high]
            place[f"{name}_worst_image"] = worst
    return results


def closed_loop_results(episodes: Iterable[Episode], confidence: float = 0.95) -> dict[str, dict]:
    """Collisions, needless stops and time to cross of every policy, in order of first appearance.

    Collision rates are over all episodes; needless stops over the episodes with a clear way, in which a stop can be
    needless.
    """
    by_policy: dict[str, list[Episode]] = {}
    for episode in episodes:
        by_policy.setdefault(episode.policy, []).append(episode)
    return {policy: _policy_results(drives, confidence) for policy, drives in by_policy.items()}


def approach_results(points: Iterable[ApproachPoint]) -> dict:
    """Pictures of each kind and how often the decision was right, beside the points themselves."""
    points = list(points)
    results: dict = {}
    for kind in ("hidden", "shown", "clear"):
        right = [point.go == (kind == "clear") for point in points if point.kind == kind]
        found = rate(sum(right), len(right))
        interval = None if found.share is None else [found.low, found.high]
        results[kind] = {"pictures": found.trials, "success": found.share, "interval": interval}
    return results | {"points": [asdict(point) for point in points]}


def _row(
    rule: str, n: int | None, go: Bool[np.ndarray, "images trials"], hazard: Bool[np.ndarray, " images"]
) -> PlanRow:
    stops, goes = ~go[hazard], go[~hazard]
    return PlanRow(
        rule=rule,
        n=n,
        hazard=rate(int(stops.sum()), stops.size),
        clear=rate(int(goes.sum()), goes.size),
        worst_hazard_image=float(stops.mean(axis=1).min()) if stops.size else None,
        worst_clear_image=float(goes.mean(axis=1).min()) if goes.size else None,
    )


def _policy_results(drives: list[Episode], confidence: float) -> dict:
    collided = rate(sum(drive.collided for drive in drives), len(drives), confidence)
    clear = [drive for drive in drives if not drive.hazard]
    needless = rate(sum(drive.needless_stop for drive in clear), len(clear), confidence)
    times = np.array([drive.time_to_cross for drive in drives if drive.time_to_cross is not None])
    quartiles = np.quantile(times, [0.25, 0.5, 0.75]).tolist() if times.size else None
    return {
        "episodes": len(drives),
        "hazard_episodes": len(drives) - len(clear),
        "collisions": collided.successes,
        "collision_rate": collided.share,
        "collision_interval": None if collided.share is None else [collided.low, collided.high],
        "needless_stops": needless.successes,
        "needless_stop_rate": needless.share,
        "needless_stop_interval": None if needless.share is None else [needless.low, needless.high],
        "crossed": int(times.size),
        "time_to_cross_s": quartiles[1] if quartiles else None,
        "time_to_cross_quartiles_s": quartiles,
        "decisions_mean": float(np.mean([drive.decisions for drive in drives])),
    }
