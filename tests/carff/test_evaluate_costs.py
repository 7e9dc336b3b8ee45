"""Recorded episodes, and what every stage cost."""

import json
from dataclasses import replace

import pytest

from carff import evaluate_costs as costs_part
from carff.closed_loop_file import ClosedLoop, save_closed_loop
from carff.evaluate_costs import evaluate_closed_loop, evaluate_costs
from carff.planning_metrics import ApproachPoint, Episode
from hashnerf.stage_costs import peak_memory_mb


def in_a_world(evaluation):
    scene = replace(evaluation.model.scene, world={"scenario": "intersection"})
    object.__setattr__(evaluation.model, "scene", scene)
    return evaluation


def test_episodes_are_read_from_the_run_folder(tiny_evaluation):
    evaluation = in_a_world(tiny_evaluation)
    assert "plan_carla.py --run" in evaluate_closed_loop(evaluation).not_run["closed_loop"]
    crash = Episode("risk", 1, True, True, False, False, None, 3)
    fine = Episode("risk", 0, False, False, True, True, 4.0, 5)
    along = (ApproachPoint(1, 0, 8.0, "hidden", 0.1, True), ApproachPoint(1, 0, 9.0, "hidden", 0.5, False))
    save_closed_loop(evaluation.config.folder, ClosedLoop((crash, fine), along, {"samples": 10}))
    part = evaluate_closed_loop(evaluation)
    assert part.results["closed_loop"]["risk"]["collisions"] == 1
    assert part.results["closed_loop"]["risk"]["needless_stop_rate"] == 1.0
    assert part.results["closed_loop_settings"] == {"samples": 10}
    assert part.results["approach"]["hidden"]["success"] == 0.5
    assert part.not_run == {"approach.clear": "no picture is clear"}
    assert set(part.figures) == {"closed_loop", "approach"}


def test_episodes_that_all_met_another_actor_leave_needless_stops_open(tiny_evaluation):
    evaluation = in_a_world(tiny_evaluation)
    crash = Episode("risk", 1, True, True, False, False, None, 3)
    save_closed_loop(evaluation.config.folder, ClosedLoop((crash,), (), {}))
    assert "drive more episodes" in evaluate_closed_loop(evaluation).not_run["closed_loop.risk.needless_stop_rate"]


def test_a_world_that_cannot_be_driven_in_gives_its_reason(tiny_evaluation):
    evaluation = in_a_world(tiny_evaluation)
    save_closed_loop(evaluation.config.folder, ClosedLoop(reason="the ego stands still"))
    assert evaluate_closed_loop(evaluation).not_run == dict.fromkeys(
        ("closed_loop", "approach"), "the ego stands still"
    )


def test_photographs_have_no_world_to_drive_in(tiny_evaluation):
    assert "not rendered from an embedded world" in evaluate_closed_loop(tiny_evaluation).not_run["closed_loop"]


def test_costs_of_training_add_up_with_this_evaluation(tiny_evaluation):
    part = evaluate_costs(tiny_evaluation, 2.0)
    # three models of 1.5 s each and 2 s of evaluation
    assert part.results["seconds_total"] == pytest.approx(6.5)
    assert part.results["seconds_cover"] == "trainings and evaluation only"
    names = [stage["name"] for stage in part.results["stages"]]
    assert names == ["PC-VAE", "radiance field", "forecast", "evaluation"]
    assert set(part.figures) == {"stages"}


def test_the_two_radiance_fields_are_listed_apart(tiny_evaluation, monkeypatch):
    (tiny_evaluation.config.folder / "nerf_birds_eye").mkdir()
    held_out = {"seconds": 7.0, "peak_memory_mb": 5.0}
    monkeypatch.setattr(costs_part, "load_nerf", lambda config, scene, held_out: (None, cost))
    cost = held_out
    stages = {stage["name"]: stage["seconds"] for stage in evaluate_costs(tiny_evaluation, 0.0).results["stages"]}
    assert stages["radiance field"] == 7.0 and stages["radiance field, with bird's-eye camera"] == 1.5


def test_whole_processes_that_were_timed_count_instead(tiny_evaluation):
    timed = {
        "data set": {"seconds": 10.0, "peak_memory_mb": 1.0},
        "PC-VAE": {"seconds": 20.0, "peak_memory_mb": 2.0},
        "radiance field": {"seconds": 3.0, "peak_memory_mb": 2.0},
        "forecast": {"seconds": 4.0, "peak_memory_mb": 2.0},
        "evaluation": {"seconds": 99.0, "peak_memory_mb": 3.0},
    }
    (tiny_evaluation.config.folder / "timings.json").write_text(json.dumps({"stages": timed}))
    results = evaluate_costs(tiny_evaluation, 5.0).results
    assert results["seconds_total"] == 42.0, "10 + 20 + 3 + 4 + 5; an earlier evaluation does not count"
    assert results["seconds_cover"] == "whole run"
    assert [stage["name"] for stage in results["stages"]] == [*timed]


def test_a_run_that_was_finished_stage_by_stage_has_no_whole_time(tiny_evaluation):
    timed = {name: {"seconds": 10.0, "peak_memory_mb": 1.0} for name in ("data set", "PC-VAE")}
    (tiny_evaluation.config.folder / "timings.json").write_text(json.dumps({"stages": timed}))
    results = evaluate_costs(tiny_evaluation, 2.0).results
    assert results["seconds_cover"] == "trainings and evaluation only" and results["seconds_total"] == 6.5


def test_an_earlier_evaluation_alone_is_no_timing_of_the_stages(tiny_evaluation):
    timed = {"evaluation": {"seconds": 99.0, "peak_memory_mb": 3.0}}
    (tiny_evaluation.config.folder / "timings.json").write_text(json.dumps({"stages": timed}))
    assert evaluate_costs(tiny_evaluation, 2.0).results["seconds_total"] == 6.5


def test_memory_is_in_megabytes():
    assert 50 < peak_memory_mb() < 100_000
