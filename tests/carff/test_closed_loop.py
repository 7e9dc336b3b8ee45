"""Episodes of all policies: the same drives for each, decisions only where they matter, honest comparison."""

from dataclasses import asdict, replace

import numpy as np
import pytest
import torch

from carff import closed_loop as module
from carff.closed_loop import (
    SeeingPolicy,
    compared,
    drive_episodes,
    drive_run,
    undrivable,
)
from carff.closed_loop_file import load_closed_loop
from carff.driving import Drive, DrivingConfig, Setup, begin, draw_setup, stop_matters
from carff.planner import PlannerConfig, decide
from carff.planning_metrics import ApproachPoint
from carff.state_memory import StateMemory
from hashnerf.errors import UserError
from worlds.cube_cylinder import CubeCylinderConfig
from worlds.dataset import world_description
from worlds.intersection import IntersectionConfig
from worlds.scenarios import build_world
from worlds.single_scene_intersection import SingleSceneIntersectionConfig

WORLD = build_world(IntersectionConfig(), 0)
DESCRIPTION = world_description(WORLD)
CONFIG = DrivingConfig()


def setups(count: int) -> list[Setup]:
    rng = np.random.default_rng(1)
    return [draw_setup(WORLD, CONFIG, rng) for _ in range(count)]


def test_policies_are_asked_for_all_open_drives_at_once_and_only_where_stopping_matters():
    calls: list[list[Drive]] = []

    def cautious(drives: list[Drive], numbers: list[int]) -> list[bool]:
        calls.append(drives)
        return [False] * len(drives)

    drives, decisions = drive_episodes(WORLD, cautious, setups(5), CONFIG)
    assert all(stop_matters(WORLD, drive, CONFIG) for batch in calls for drive in batch)
    assert sum(map(len, calls)) == sum(decisions) and max(map(len, calls)) == 5
    assert all(drive.stood and not drive.over for drive in drives)
    # Standing from about second 5 to 25, a decision every 8 ticks of 0.05 s = 0.4 s.
    assert all(45 < count <= 62 for count in decisions)


def test_an_ego_that_was_told_too_late_drives_on():
    def late(drives: list[Drive], numbers: list[int]) -> list[bool]:
        return [WORLD.traffic.stop - drive.s > 5.6 for drive in drives]

    drives, _ = drive_episodes(WORLD, late, setups(12), CONFIG)
    through = [drive for drive in drives if not drive.stood]
    assert through, "8 m/s covers 3.2 m between decisions: some are told when 5.1 m are no longer left"
    assert all(drive.over for drive in through)


def test_a_seeing_policy_decides_from_each_drives_own_picture(tiny_evaluation, monkeypatch):
    shown: list[torch.Tensor] = []

    def from_pictures(model, pictures, planner, n, generator, rule_out):
        shown.append(pictures)
        assert (planner.rule, n) == ("paper", 7)
        flags = pictures.flatten(1).float().mean(dim=1) > 100
        for place in range(len(pictures)):
            rule_out(place, torch.eye(4)[[place]])
        return [decide(flag[None], ~flag[None] & False, planner) for flag in flags]

    monkeypatch.setattr(module, "decide_from_pictures", from_pictures)

    def look(drives: list[Drive]) -> torch.Tensor:
        return torch.stack([torch.full((32, 32, 3), int(drive.s), dtype=torch.uint8) for drive in drives])

    policy = SeeingPolicy(tiny_evaluation.model, look, PlannerConfig(rule="paper"), 7, 0, step_seconds=1.0)
    drives = [replace(begin(setups(1)[0]), s=s) for s in (50.0, 150.0)]
    assert policy(drives, [3, 8]) == [True, False]
    # each drive remembers its own readings, whatever its place among those that are open
    assert {number: int(memory.belief.argmax()) for number, memory in policy.memories.items()} == {3: 0, 8: 1}
    assert shown[0].shape == (2, 32, 32, 3)


def test_policies_are_compared_setup_by_setup():
    quiet, danger = Setup(0, {"ego": 0.0}, {"ego": 8.0}), Setup(1, {"ego": 0.0}, {"ego": 8.0})

    def drives(*ends: dict) -> tuple[list[Drive], list[int]]:
        return [Drive(one, 9.0, 1.0, 1.0, **end) for one, end in zip((quiet, danger), ends)], [2, 5]

    runs = {
        "oracle": drives({"crossed": 3.0}, {"crossed": 6.0, "stood": True}),
        "always_go": drives({"crossed": 3.0}, {"collided": True}),
        "risk": drives({"crossed": 7.0, "stood": True}, {"crossed": 8.0, "stood": True}),
    }
    by_policy = {name: [one for one in compared(runs) if one.policy == name] for name in runs}
    assert [one.hazard for one in by_policy["risk"]] == [False, True]
    assert [one.needless_stop for one in by_policy["risk"]] == [True, False], "the oracle stood as well"
    assert [one.collided for one in by_policy["always_go"]] == [False, True]
    assert [one.time_to_cross for one in by_policy["oracle"]] == [3.0, 6.0]
    assert [one.decisions for one in by_policy["risk"]] == [2, 5]


def in_a_world(evaluation, description: dict | None):
    scene = replace(evaluation.model.scene, world=description)
    object.__setattr__(evaluation.model, "scene", scene)
    return evaluation.model


def test_a_run_is_driven_with_every_policy_over_the_same_episodes(tiny_evaluation, monkeypatch):
    model = in_a_world(tiny_evaluation, DESCRIPTION)
    monkeypatch.setattr(module, "load_carff", lambda folder: model)

    def by_rule(model, pictures, planner, n, generator, rule_out):  # risk never waits here, paper always
        hazard = torch.tensor([planner.rule == "paper"])
        return [decide(hazard, ~hazard & False, replace(planner, rule="paper")) for _ in pictures]

    monkeypatch.setattr(module, "decide_from_pictures", by_rule)
    steps = set()

    class Recording(StateMemory):
        def __init__(self, transitions, same, step_seconds):
            steps.add(step_seconds)
            super().__init__(transitions, same, step_seconds)

    monkeypatch.setattr(module, "StateMemory", Recording)
    point = ApproachPoint(0, 0, 3.0, "clear", 0.0, True)
    monkeypatch.setattr(module, "decide_along_approach", lambda *_: [point])
    folder = tiny_evaluation.config.folder
    brief = replace(CONFIG, longest=8.0)
    driven = drive_run(folder, 6, 3, brief, seed=1, workers=1)
    episodes = {
        name: [one for one in driven.episodes if one.policy == name] for name in {e.policy for e in driven.episodes}
    }
    assert set(episodes) == {"always_stop", "always_go", "oracle", "risk", "paper"}
    assert steps == {WORLD.traffic.step_seconds}
    assert len({tuple((one.branch, one.hazard) for one in own) for own in episodes.values()}) == 1
    assert {one.branch for one in episodes["risk"]} == {0, 1}
    assert [one.collided for one in episodes["risk"]] == [one.hazard for one in episodes["risk"]]
    assert all(one.stopped and not one.collided for one in episodes["paper"])
    assert all(one.needless_stop for one in episodes["paper"] if one.branch == 0)
    assert not any(one.collided for one in episodes["oracle"])
    recorded = load_closed_loop(folder)
    assert recorded.episodes == driven.episodes and recorded.approach == (point,)
    assert recorded.about["samples"] == 3 and recorded.about["driving"] == asdict(brief)


def test_worlds_without_a_moving_ego_give_a_reason(tiny_evaluation, monkeypatch):
    assert undrivable(WORLD) == ""
    waiting = build_world(SingleSceneIntersectionConfig(), 0)
    assert "stands still" in undrivable(waiting)
    model = in_a_world(tiny_evaluation, world_description(build_world(CubeCylinderConfig(), 0)))
    monkeypatch.setattr(module, "load_carff", lambda folder: model)
    driven = drive_run(tiny_evaluation.config.folder, 6, 3, CONFIG, 1)
    assert driven.reason == "nothing drives in cube_cylinder" and not driven.episodes + driven.approach
    assert load_closed_loop(tiny_evaluation.config.folder).reason == driven.reason


def test_photographs_cannot_be_driven_in(tiny_evaluation, monkeypatch):
    monkeypatch.setattr(module, "load_carff", lambda folder: tiny_evaluation.model)
    with pytest.raises(UserError, match="not rendered from an embedded world"):
        drive_run(tiny_evaluation.config.folder, 1, 1, CONFIG, 0)
