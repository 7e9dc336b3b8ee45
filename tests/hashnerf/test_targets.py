import math

import pytest

from hashnerf.targets import Target, judge, limit_of, lookup, reason_for

PSNR = Target("nerf.psnr_db", "how like the truth", ">=", "dB", 20.0, 25.0)
CRASHES = Target("drive.crashes", "crashes", "==", "", 0.0, None)


def test_lookup_follows_the_path():
    results = {"plan": {"risk": {"n10": {"hazard_success": 0.9}}}, "seconds_total": 3.0}
    assert lookup(results, "plan.risk.n10.hazard_success") == 0.9 and lookup(results, "seconds_total") == 3.0
    assert lookup(results, "plan.paper.n10") is None and lookup(results, "seconds_total.x") is None


def test_a_reason_covers_everything_below_its_key():
    reasons = {"closed_loop": "no world", "plan.risk.n2": "skipped"}
    assert reason_for("closed_loop.risk.collisions", reasons) == "no world"
    assert reason_for("plan.risk.n2.hazard_success", reasons) == "skipped"
    assert reason_for("plan.risk.n10.hazard_success", reasons) == "" and reason_for("closed_loops", reasons) == ""


@pytest.mark.parametrize(
    ("value", "preset", "met"),
    [
        (20.0, "fast", True),
        (20.0 - 1e-12, "fast", True),
        (19.99, "fast", False),
        (24.0, "balanced", False),
        (math.nan, "fast", False),
        (math.inf, "fast", False),
        (19.0, "other", None),
    ],
)
def test_limits_are_inclusive_and_nothing_but_numbers_meets_them(value, preset, met):
    (verdict,) = judge([PSNR], {"nerf": {"psnr_db": value}}, preset, {})
    assert verdict.met is met and verdict.limit == limit_of(PSNR, preset) and verdict.reason == ""


def test_what_was_not_run_is_not_judged_and_says_why():
    psnr, crashes = judge([PSNR, CRASHES], {}, "fast", {"drive": "there is no road"})
    assert (psnr.met, psnr.measured, psnr.reason) == (None, None, "no value")
    assert (crashes.met, crashes.limit, crashes.reason) == (None, 0.0, "there is no road")


def test_an_exemption_takes_the_limit_away_and_gives_the_reason():
    results = {"nerf": {"psnr_db": 1.0}, "drive": {"crashes": 2}}
    why = {"nerf.psnr_db": "equal pictures"}
    psnr, crashes = judge([PSNR, CRASHES], results, "fast", {}, lambda target, limit: why.get(target.key))
    assert (psnr.met, psnr.limit, psnr.measured, psnr.reason) == (None, None, 1.0, "equal pictures")
    assert crashes.met is False
    (quiet,) = judge([PSNR], results, "fast", {}, lambda target, limit: "")
    assert quiet.met is None and quiet.reason == ""
