"""What a run of CARFF must reach, preset by preset, and whether it did.

Keys are dotted paths into the nested results (`plan.risk.n10.hazard_success`), see `hashnerf.targets`. `derived` adds
the figures that are differences of others, so that no caller computes them in its own way.
"""

from collections.abc import Mapping

from hashnerf.targets import WHOLE_RUN, Target, Verdict, limit_of, lookup
from hashnerf.targets import judge as judge_targets

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
# The figure in whose place another one is judged, where equal pictures put that one's limit out of reach.
STANDS_FOR = {
    "pcvae.svm_visible_gap": "pcvae.svm_visible",
    "pcvae.svm_visible_heldout_gap": "pcvae.svm_visible_heldout",
}


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

    def exempt(target: Target, limit: float | None) -> str | None:
        cover = results.get("seconds_cover", WHOLE_RUN)
        if target.key == "seconds_total" and cover != WHOLE_RUN:
            return f"{cover}: run scripts/demo.py to time the whole run"
        ceiling = _low_ceiling(results, target.key, limit)
        if ceiling is not None:
            return f"equal pictures of different states allow {ceiling:.1%} at most"
        other = STANDS_FOR.get(target.key)
        return "" if other and _is_judged(results, other, preset) else None

    return judge_targets(TARGETS, results, preset, not_run, exempt)


def _is_judged(results: Mapping, key: str, preset: str) -> bool:
    limit = limit_of(next(target for target in TARGETS if target.key == key), preset)
    return limit is not None and (lookup(results, key) is None or _low_ceiling(results, key, limit) is None)


def _low_ceiling(results: Mapping, key: str, limit: float | None) -> float | None:
    """What equal pictures allow at most, where that is less than the limit."""
    ceiling = lookup(results, f"{key}_ceiling")
    return ceiling if ceiling is not None and limit is not None and ceiling < limit else None


def _difference(a: float | int | None, b: float | int | None) -> float | None:
    return None if a is None or b is None else a - b
