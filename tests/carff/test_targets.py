import math

import pytest

from carff.targets import TARGETS, derived, judge


def _verdict(results: dict, key: str, preset: str = "fast", not_run: dict | None = None):
    return next(verdict for verdict in judge(results, preset, not_run or {}) if verdict.target.key == key)


@pytest.mark.parametrize(
    ("key", "value", "met"),
    [
        ("pcvae.svm_visible", 0.97, True),
        ("pcvae.svm_visible", 0.9699, False),
        ("forecast.branch_ece", 0.08, True),
        ("forecast.branch_ece", 0.0801, False),
        ("nerf.state_identified", 1.0, True),
        ("nerf.state_identified", 5 / 6, False),
        ("nerf.psnr_matched_db", math.nan, False),
        ("forecast.branch_ece", -math.inf, False),
    ],
)
def test_limits_are_inclusive_and_nothing_but_numbers_meets_them(key, value, met):
    head, leaf = key.split(".")
    assert _verdict({head: {leaf: value}}, key).met is met


def test_rounding_of_a_difference_does_not_miss_a_limit():
    # 0.97 - 0.99 is -0.02 with a rounding error of 2e-17 on the wrong side.
    rows = {
        "n10": {"hazard_success": 0.99, "clear_success": 0.97},
        "n35": {"hazard_success": 0.97, "clear_success": 0.98},
    }
    results = derived({"plan": {"risk": rows}})
    assert results["plan"]["risk"]["n35_change"] == pytest.approx(-0.02)
    assert _verdict(results, "plan.risk.n35_change").met is True
    assert _verdict(results, "plan.risk.n35_change", "balanced").met is False


def test_a_limit_above_what_equal_pictures_allow_is_not_judged():
    found = _verdict({"pcvae": {"svm_visible": 0.7, "svm_visible_ceiling": 0.742}}, "pcvae.svm_visible")
    assert (found.met, found.limit, found.measured) == (None, None, 0.7)
    assert found.reason == "equal pictures of different states allow 74.2% at most"
    assert _verdict({"pcvae": {"svm_visible": 0.7, "svm_visible_ceiling": 0.98}}, "pcvae.svm_visible").met is False
    within = derived({"pcvae": {"svm_visible": 0.9, "svm_visible_ceiling": 0.98}})
    assert _verdict(within, "pcvae.svm_visible_gap").met is None, "judged once, not twice"
    gap = derived({"pcvae": {"svm_visible": 0.7, "svm_visible_ceiling": 0.742}})
    assert _verdict(gap, "pcvae.svm_visible_gap").met is False, "0.042 is more than 3 points"


def test_derived_differences_by_hand():
    results = derived(
        {
            "pcvae": {"svm_all": 0.7, "svm_ceiling": 0.8},
            "nerf": {"psnr_matched_db": 28.0, "psnr_matched_heldout_db": 27.0},
        }
    )
    assert results["pcvae"]["svm_gap"] == pytest.approx(0.1) and results["nerf"]["heldout_gap_db"] == 1.0
    assert derived({})["pcvae"]["svm_gap"] is None and derived({"plan": {"risk": {"n10": {}}}})["plan"]["risk"] == {
        "n10": {}
    }


def test_derived_leaves_its_input_alone():
    results = {"pcvae": {"svm_all": 0.7, "svm_ceiling": 0.8}, "plan": {"risk": {}}}
    derived(results)
    assert results == {"pcvae": {"svm_all": 0.7, "svm_ceiling": 0.8}, "plan": {"risk": {}}}


def test_presets_without_targets_are_reported_but_not_judged():
    verdict = _verdict({"nerf": {"psnr_matched_db": 10.0}}, "nerf.psnr_matched_db", "accurate")
    assert verdict.limit is None and verdict.met is None and verdict.measured == 10.0


def test_what_was_not_run_is_not_judged_and_says_why():
    verdict = _verdict({}, "closed_loop.risk.collisions", not_run={"closed_loop": "the data names no world"})
    assert verdict.met is None and verdict.reason == "the data names no world"


def test_a_part_of_the_run_is_not_judged_as_a_whole():
    partial = _verdict({"seconds_total": 10.0, "seconds_cover": "trainings and evaluation only"}, "seconds_total")
    assert partial.met is None and partial.measured == 10.0 and "trainings and evaluation only" in partial.reason
    assert _verdict({"seconds_total": 10.0, "seconds_cover": "whole run"}, "seconds_total").met


def test_balanced_is_never_easier_than_fast():
    for target in TARGETS:
        if target.fast is not None and target.key != "seconds_total":
            harder = target.balanced >= target.fast if target.comparison == ">=" else target.balanced <= target.fast
            assert harder, target.key
