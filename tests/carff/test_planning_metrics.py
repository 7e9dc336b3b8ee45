import numpy as np
import pytest

from carff.planning_metrics import (
    ALWAYS_GO,
    ALWAYS_STOP,
    ApproachPoint,
    Episode,
    approach_results,
    closed_loop_results,
    plan_results,
    planning_table,
    policy_label,
    rate,
)

HAZARD = np.array([True, True, False])


def _episode(policy: str = "risk", hazard: bool = False, **values) -> Episode:
    base = {"branch": int(hazard), "collided": False, "stopped": False, "needless_stop": False}
    return Episode(policy=policy, hazard=hazard, **(base | {"time_to_cross": 4.0, "decisions": 5} | values))


def test_baselines_are_right_on_one_side_only():
    under, over = planning_table({}, HAZARD)
    assert (under.rule, under.hazard.share, under.clear.share) == (ALWAYS_STOP, 1.0, 0.0)
    assert (over.rule, over.hazard.share, over.clear.share) == (ALWAYS_GO, 0.0, 1.0)
    assert under.n is None


def test_success_is_waiting_at_a_hazard_and_going_when_clear():
    # Hazard images: 3 of 4 and 4 of 4 trials wait; the clear image goes in 2 of 4.
    go = np.array([[True, False, False, False], [False] * 4, [True, True, False, False]])
    row = planning_table({("risk", 10): go}, HAZARD)[-1]
    assert (row.hazard.successes, row.hazard.trials, row.clear.successes, row.clear.trials) == (7, 8, 2, 4)
    assert row.worst_hazard_image == 0.75 and row.worst_clear_image == 0.5
    assert row.hazard.low < 7 / 8 < row.hazard.high


def test_wilson_interval_by_hand():
    # 30 of 30 at 95 %: z^2 = 3.8415, low = 30 / (30 + 3.8415) = 0.88649, high = 1.
    value = rate(30, 30)
    assert value.low == pytest.approx(0.88649, abs=1e-4) and value.high == pytest.approx(1.0)
    assert rate(0, 0).share is None


def test_table_without_clear_images_leaves_those_cells_empty():
    row = planning_table({("risk", 2): np.zeros((1, 3), bool)}, np.array([True]))[-1]
    assert row.clear.share is None and row.worst_clear_image is None and row.hazard.share == 1.0


def test_results_nest_by_rule_and_n():
    go = np.array([[False] * 3, [False] * 3, [True] * 3])
    results = plan_results(planning_table({("risk", 10): go, ("paper", 35): ~go}, HAZARD))
    assert results["risk"]["n10"]["hazard_success"] == results["risk"]["n10"]["clear_success"] == 1.0
    assert results["paper"]["n35"]["hazard_success"] == 0.0
    assert results["risk"]["n10"]["hazard_count"] == [6, 6]
    assert results[ALWAYS_GO]["clear_success"] == 1.0
    assert len(results["risk"]["n10"]["clear_interval"]) == 2


def test_closed_loop_by_hand():
    episodes = [
        _episode(hazard=True, collided=True, time_to_cross=None),
        _episode(hazard=True, stopped=True, time_to_cross=8.0),
        _episode(time_to_cross=4.0),
        _episode(stopped=True, needless_stop=True, time_to_cross=6.0),
        _episode(policy="oracle", time_to_cross=3.0),
    ]
    results = closed_loop_results(episodes)
    assert list(results) == ["risk", "oracle"]
    risk = results["risk"]
    assert (risk["episodes"], risk["collisions"], risk["collision_rate"]) == (4, 1, 0.25)
    # Two of four episodes are clear, one of them stopped for nothing.
    assert (risk["needless_stops"], risk["needless_stop_rate"]) == (1, 0.5)
    assert risk["crossed"] == 3 and risk["time_to_cross_s"] == 6.0
    assert risk["time_to_cross_quartiles_s"] == [5.0, 6.0, 7.0]
    assert results["oracle"]["needless_stop_rate"] == 0.0


def test_a_policy_that_never_crosses_and_never_met_a_clear_way():
    results = closed_loop_results([_episode(hazard=True, stopped=True, time_to_cross=None)])["risk"]
    assert results["time_to_cross_s"] is None and results["time_to_cross_quartiles_s"] is None
    assert results["needless_stop_rate"] is None and results["needless_stop_interval"] is None


def test_along_the_approach_hazards_are_waited_for_and_clear_ways_are_gone():
    kinds = {"hidden": [False, False, False, True], "shown": [False], "clear": [True, True], "other": [True]}
    points = [ApproachPoint(0, 0, 1.0, kind, 0.5, go) for kind, decisions in kinds.items() for go in decisions]
    results = approach_results(points)
    assert [results[kind]["success"] for kind in ("hidden", "shown", "clear")] == [0.75, 1.0, 1.0]
    assert results["hidden"]["pictures"] == 4
    assert results["hidden"]["interval"] == pytest.approx([0.3006, 0.9544], abs=1e-4)
    assert len(results["points"]) == 8 and results["points"][-1]["kind"] == "other"
    assert approach_results([])["clear"] == {"pictures": 0, "success": None, "interval": None}


def test_policies_have_names_for_people():
    assert policy_label("risk", 10) == "risk rule, n = 10" and policy_label("always_go").startswith("always go")
    assert policy_label("my_rule") == "my rule"


def test_no_episodes_no_policies():
    assert closed_loop_results([]) == {}
