"""What a run must reach, preset by preset, and whether it did.

A *key* is a dotted path into the nested results (`plan.risk.n10.hazard_success`). Shares are in [0, 1], PSNR in dB,
time in seconds or milliseconds as the key says. `derived` adds the figures that are differences of others, so that no
caller computes them in its own way.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

# Differences of shares carry rounding of about 1e-17; a limit met to nine digits is met.
SLACK = 1e-9


@dataclass(frozen=True)
class Target:
    """One line of the summary: a figure, and the limit it has to keep in the two presets that are judged."""

    key: str
    label: str
    comparison: str
    """`>=`, `<=` or `==`."""
    unit: str
    """How values are shown: `%`, `points` (of per cent), `dB`, `min` (stored in seconds), `ms` or empty."""
    fast: float | None
    balanced: float | None
    paper: str = ""
    """What the paper reports for the same figure, for orientation."""
    stands_for: str = ""
    """Key of the figure in whose place this one is judged, where equal pictures put that one's limit out of reach."""


TARGETS = (
    Target("seconds_total", "whole run after installation", "<=", "min", 720.0, 3600.0, "24 h on a GPU"),
    Target("pcvae.svm_visible", "state named from a training view that shows the actor", ">=", "%", 0.97, 0.99),
    Target(
        "pcvae.svm_visible_gap",
        "the same: distance to what the pixels of those views allow",
        "<=",
        "points",
        0.03,
        0.01,
        stands_for="pcvae.svm_visible",
    ),
    Target("pcvae.svm_gap", "state named from any view: distance to what the pixels allow", "<=", "points", 0.08, 0.03),
    Target(
        "pcvae.svm_visible_heldout", "state named from a held-out camera that shows the actor", ">=", "%", 0.80, 0.90
    ),
    Target(
        "pcvae.svm_visible_heldout_gap",
        "the same: distance to what the pixels of those views allow",
        "<=",
        "points",
        0.20,
        0.10,
        stands_for="pcvae.svm_visible_heldout",
    ),
    Target("pcvae.psnr_train_db", "reconstruction of training views", ">=", "dB", 32.0, 34.0, "26.5 dB"),
    Target(
        "nerf.psnr_matched_db", "bird's-eye rendering against its own state", ">=", "dB", 24.5, 28.0, "28.0–28.3 dB"
    ),
    Target("nerf.heldout_gap_db", "loss when the bird's-eye camera is held out", "<=", "dB", None, 1.5),
    Target("nerf.changed_px_db", "bird's-eye rendering, pixels where states differ", ">=", "dB", 21.0, 25.0),
    Target("nerf.changed_px_lead_db", "its lead over other states on those pixels", ">=", "dB", 4.0, 7.0),
    Target("nerf.state_identified", "renderings nearest to their own state", "==", "%", 1.0, 1.0),
    Target("probe.accuracy", "state read from the density, or absence recognised", ">=", "%", 0.95, 0.99),
    Target("forecast.ambiguous_branch_error", "ambiguous views: branch probability off by", "<=", "points", 0.10, 0.05),
    Target("forecast.branch_ece", "calibration error of branch probabilities", "<=", "", 0.08, 0.04),
    Target("plan.risk.n10.hazard_success", "risk rule, n = 10: waits at a hazard", ">=", "%", 0.97, 0.99, "30 of 30"),
    Target("plan.risk.n10.clear_success", "risk rule, n = 10: goes when clear", ">=", "%", 0.97, 0.99, "30 of 30"),
    Target("plan.risk.n35_change", "risk rule: change from n = 10 to n = 35", ">=", "points", -0.02, 0.0, "−37 points"),
    Target(
        "approach.hidden.success", "single pictures along the approach: waits at a hidden hazard", ">=", "%", None, None
    ),
    Target("approach.clear.success", "single pictures along the approach: goes when clear", ">=", "%", None, None),
    Target("closed_loop.risk.collisions", "closed loop, risk rule: collisions", "==", "", 0.0, 0.0),
    Target("closed_loop.risk.needless_stop_rate", "closed loop, risk rule: needless stops", "<=", "%", 0.15, 0.05),
    Target("decision_ms_n10", "one decision, n = 10", "<=", "ms", 200.0, 200.0),
)


WHOLE_RUN = "whole run"  # what `seconds_total` must cover to be judged


@dataclass(frozen=True)
class Verdict:
    """A target beside what was measured."""

    target: Target
    limit: float | None
    """None where the preset is not judged on this figure."""
    measured: float | int | None
    met: bool | None
    """None where there is no limit or the figure was not run."""
    reason: str
    """Why the figure was not run or has no limit here; empty otherwise."""


def lookup(results: Mapping, key: str) -> Any:
    """The value at a dotted key, None if any part of the path is missing."""
    value: Any = results
    for part in key.split("."):
        if not isinstance(value, Mapping) or part not in value:
            return None
        value = value[part]
    return value


def reason_for(key: str, not_run: Mapping[str, str]) -> str:
    """Why `key` was not run: its own entry or that of a parent (`closed_loop` covers `closed_loop.risk.collisions`)."""
    parts = key.split(".")
    for end in range(len(parts), 0, -1):
        prefix = ".".join(parts[:end])
        if prefix in not_run:
            return not_run[prefix]
    return ""


def derived(results: Mapping) -> dict:
    """The results with the figures that follow from others: SVM gaps, held-out gap and the change from n = 10 to 35."""
    pcvae, nerf = dict(results.get("pcvae", {})), dict(results.get("nerf", {}))
    plan = {rule: dict(rows) for rule, rows in results.get("plan", {}).items()}
    for name, ceiling, reached in (
        ("svm_gap", "svm_ceiling", "svm_all"),
        ("svm_visible_gap", "svm_visible_ceiling", "svm_visible"),
        ("svm_visible_heldout_gap", "svm_visible_heldout_ceiling", "svm_visible_heldout"),
    ):
        pcvae[name] = _difference(pcvae.get(ceiling), pcvae.get(reached))
    nerf["heldout_gap_db"] = _difference(nerf.get("psnr_matched_db"), nerf.get("psnr_matched_heldout_db"))
    for rows in plan.values():
        changes = [
            _difference(lookup(rows, f"n35.{side}_success"), lookup(rows, f"n10.{side}_success"))
            for side in ("hazard", "clear")
        ]
        if None not in changes:
            rows["n35_change"] = min(changes)
    return dict(results) | {"pcvae": pcvae, "nerf": nerf, "plan": plan}


def judge(results: Mapping, preset: str, not_run: Mapping[str, str]) -> list[Verdict]:
    """Every target beside its measurement; presets other than `fast` and `balanced` are reported without limits."""
    return [_verdict(target, results, preset, not_run) for target in TARGETS]


def _verdict(target: Target, results: Mapping, preset: str, not_run: Mapping[str, str]) -> Verdict:
    limit = {"fast": target.fast, "balanced": target.balanced}.get(preset)
    measured = lookup(results, target.key)
    if measured is None:
        return Verdict(target, limit, None, None, reason_for(target.key, not_run) or "no value")
    cover = results.get("seconds_cover", WHOLE_RUN)
    if target.key == "seconds_total" and cover != WHOLE_RUN:
        return Verdict(target, None, measured, None, f"{cover}: run scripts/demo.py to time the whole run")
    ceiling = lookup(results, f"{target.key}_ceiling")
    if ceiling is not None and limit is not None and ceiling < limit:
        return Verdict(target, None, measured, None, f"equal pictures of different states allow {ceiling:.1%} at most")
    if target.stands_for and _verdict(_target(target.stands_for), results, preset, not_run).limit is not None:
        return Verdict(target, None, measured, None, "")
    return Verdict(target, limit, measured, None if limit is None else _keeps(measured, target.comparison, limit), "")


def _target(key: str) -> Target:
    return next(target for target in TARGETS if target.key == key)


def _keeps(measured: float | int, comparison: str, limit: float) -> bool:
    if not math.isfinite(measured):
        return False
    distance = {">=": measured - limit, "<=": limit - measured, "==": -abs(measured - limit)}[comparison]
    return distance >= -SLACK


def _difference(a: float | int | None, b: float | int | None) -> float | None:
    return None if a is None or b is None else a - b
