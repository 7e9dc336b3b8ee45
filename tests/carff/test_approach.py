"""Decisions at places where no camera of the data stands."""

from collections import Counter
from dataclasses import replace
from itertools import pairwise

import pytest
import torch

from carff import approach as module
from carff.approach import SPACING, approach_places, decide_along_approach, standing
from carff.driving import DrivingConfig, actor_poses
from worlds.intersection import IntersectionConfig
from worlds.scenarios import build_world

WORLD = build_world(IntersectionConfig(), 0)
CONFIG = DrivingConfig()


def test_places_lead_from_the_stop_line_to_the_farthest_start():
    places = approach_places(WORLD, CONFIG)
    assert places[0] == WORLD.traffic.stop
    assert all(before - after == pytest.approx(SPACING) for before, after in pairwise(places))
    farthest = WORLD.traffic.starts[0, 0, "ego"] - CONFIG.start_jitter
    assert farthest <= places[-1] < farthest + SPACING


def test_a_start_beyond_the_line_leaves_the_line():
    late = dict.fromkeys(WORLD.traffic.starts, WORLD.traffic.stop + 9)
    assert approach_places(replace(WORLD, traffic=replace(WORLD.traffic, starts=late)), CONFIG) == [WORLD.traffic.stop]


def test_actors_stand_where_the_data_has_them():
    for state in WORLD.states:
        drive = standing(WORLD, (state.branch, state.step), 20.0)
        assert (drive.s, drive.speed) == (20.0, 0.0)
        poses = actor_poses(WORLD, drive.setup, drive.time)
        assert set(poses) == set(state.poses) - {"ego"}
        for name, pose in poses.items():
            assert (pose.x, pose.y) == pytest.approx((state.poses[name].x, state.poses[name].y))


def test_every_place_is_decided_by_its_own_picture(tiny_evaluation, monkeypatch):
    """The cameras of the data stand for four places; camera 0 does not see the truck."""
    table, images = tiny_evaluation.table, tiny_evaluation.data.images
    monkeypatch.setattr(module, "approach_places", lambda *_: [20.0, 19.0, 18.0, 17.0])

    def look(drives) -> torch.Tensor:
        assert [drive.s for drive in drives] == [20.0, 19.0, 18.0, 17.0] * 4
        return images[table.views.flatten()]

    points = decide_along_approach(tiny_evaluation.model, WORLD, look, 20, CONFIG, seed=0)
    assert Counter((one.branch, one.step) for one in points) == {(0, 0): 4, (1, 0): 4}, "last steps have no next one"
    stop = WORLD.traffic.stop
    assert [one.to_line for one in points[:4]] == pytest.approx([stop - s for s in (20, 19, 18, 17)], abs=1e-3)
    assert [one.kind for one in points] == ["other", "clear", "clear", "clear", "hidden", "shown", "shown", "shown"]
    assert [one.go for one in points] == [False, True, True, True] + [False] * 4
    shares = [one.hazard_share for one in points]
    assert shares[1:4] == [0.0] * 3 and shares[5:] == [1.0] * 3 and 0.2 < shares[0] < 0.8
