"""Targets of the presets, and figures that sum up tables."""

import pytest

from aerial2ground.report_words import PAPER_TABLE_1, PAPER_TABLE_2
from aerial2ground.targets import TARGETS, derived, judge, required_keys
from hashnerf.report_tables import number
from hashnerf.targets import lookup


def verdict(results: dict, key: str, preset: str = "fast", not_run: dict | None = None):
    return next(one for one in judge(derived(results), preset, not_run or {}) if one.target.key == key)


def drives(**methods: tuple[float, float, float]) -> dict:
    return {name: dict(zip(("pos_m", "yaw_deg", "interventions"), values)) for name, values in methods.items()}


def test_the_worst_trajectory_and_the_mean_difference_by_hand():
    table = {
        "a": drives(ours=(0.02, 3.0, 0), imit_gv=(0.05, 2.0, 1), ours_gv=(0.03, 2.5, 0)),
        "b": drives(ours=(0.04, 1.0, 2), imit_gv=(0.05, 2.0, 0), ours_gv=(0.06, 1.0, 0)),
    }
    results = derived({"table2": table})
    assert results["table2_worst"]["ours"] == {"pos_m": 0.04, "yaw_deg": 3.0, "interventions": 2}
    # position: ((0.03 - 0.05) + (0.06 - 0.05)) / 2; yaw: (0.5 - 1) / 2; interventions: (-1 + 0) / 2
    assert list(results["table2_order"].values()) == pytest.approx([-0.005, -0.25, -0.5])
    assert verdict({"table2": table}, "table2_order.pos_m").met
    assert verdict({"table2": table}, "table2_worst.ours.interventions").met is False


def test_the_papers_own_tables_stand_beside_the_targets():
    columns = ("pos_m", "yaw_deg", "interventions")
    table1 = {
        f"layout_{k}": {m: dict(zip(columns, v)) for m, v in rows.items()} for k, rows in enumerate(PAPER_TABLE_1)
    }
    table2 = {f"path {k}": {m: dict(zip(columns, v)) for m, v in rows.items()} for k, rows in enumerate(PAPER_TABLE_2)}
    results = derived({"table1": table1, "table2": table2})
    told = [target for target in TARGETS if target.paper]
    assert len(told) == 10
    for target in told:
        text = number(lookup(results, target.key), target.unit)
        assert float(text.split()[0].replace("−", "-")) == pytest.approx(
            float(target.paper.split()[0].replace("−", "-")), abs=5e-3
        ), target.key


def test_the_gain_of_the_road_prior():
    results = {"ground": {"psnr_db": {"none": 18.0, "full": 21.5}, "hidden_road_psnr_db": {"full": 20.0}}}
    assert derived(results)["prior_gain"]["psnr_db"] == 3.5
    assert derived(results)["prior_gain"]["hidden_road_psnr_db"] is None
    one = verdict({"ground": {"hidden_road_psnr_db": {"none": 15.0, "full": 20.0}}}, "prior_gain.hidden_road_psnr_db")
    assert (one.measured, one.limit, one.met) == (5.0, None, None), "one seed proves nothing: reported, not judged"


def test_a_table_that_is_missing_gives_its_reason_to_what_sums_it_up():
    reasons = {"table2": "nobody drove", "table1.layout_0": "nobody looked"}
    assert verdict({}, "table2_order.yaw_deg", not_run=reasons).reason == "nobody drove"
    assert verdict({}, "table1_worst.ours.pos_m", not_run=reasons).reason == "nobody looked"


def test_required_keys_follow_the_data():
    keys = required_keys(["loop"], ["layout_0"])
    assert "table2.loop.imit_gv.interventions" in keys and "table1.layout_0.ours_imu.yaw_deg" in keys
    assert {f"ground.psnr_db.{prior}" for prior in ("none", "colour", "colour_depth", "full")} <= set(keys)
    assert "table2" in required_keys([], [])


def test_balanced_is_never_easier_than_fast():
    for target in TARGETS:
        if target.fast is not None and target.key != "seconds_total":
            harder = target.balanced >= target.fast if target.comparison == ">=" else target.balanced <= target.fast
            assert harder, target.key


def test_a_part_of_a_run_is_not_judged_as_a_whole():
    part = verdict({"seconds_total": 10.0, "seconds_cover": "without radiance fields"}, "seconds_total")
    assert (part.met, part.reason) == (None, "without radiance fields")
    assert verdict({"seconds_total": 901.0}, "seconds_total").met is False
