import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from hashnerf.errors import UserError
from worlds.boxes import Pose, box_at
from worlds.dataset import world_description
from worlds.intersection import IntersectionConfig
from worlds.rig import CLEARANCE
from worlds.scenarios import build_scene, build_world, world_from_description
from worlds.scene import ego_camera
from worlds.shading import Light
from worlds.two_lane_merge import TwoLaneMergeConfig

CONFIG = IntersectionConfig()


def test_a_scene_at_the_poses_of_a_state_is_that_state():
    world = build_world(CONFIG, 0)
    scene = build_scene(CONFIG, 0, world.states[5].poses)
    assert scene.box("truck").center[2] == pytest.approx(world.actors["truck"].size[2] / 2)
    assert "truck" not in build_scene(CONFIG, 0, world.states[0].poses).poses


def test_an_unknown_actor_is_refused():
    with pytest.raises(UserError, match="intersection has no actor 'bus'; its actors are ego, truck"):
        build_scene(CONFIG, 0, {"bus": Pose(0.0, 0.0, 0.0, 0.0)})


@pytest.mark.parametrize("config", [CONFIG, TwoLaneMergeConfig()])
def test_the_ego_camera_sits_ahead_of_the_bumper_and_turns_with_the_ego(config):
    world = build_world(config, 0)
    for state in world.states[:3]:
        ego = state.poses["ego"]
        pose = ego_camera(world, ego).pose[0].double().numpy()
        gap = box_at(ego, world.actors["ego"].size).distance(pose[None, :3, 3])
        assert CLEARANCE - 1e-5 <= gap[0] < CLEARANCE + 0.5
        assert pose[2, 3] == pytest.approx(config.ego_camera.height)
        forward = -pose[:3, 2]
        left = np.arctan2(forward[1], forward[0]) - ego.yaw
        yaw, pan = config.ego_camera.yaw, config.ego_camera.pan
        assert np.deg2rad(yaw) - 1e-4 <= left <= np.deg2rad(yaw + pan) + 1e-4


def test_the_ego_camera_is_among_the_cameras_of_the_rig():
    world = build_world(CONFIG, 0)
    rig = world.rig.cameras.pose[:56, :3, 3].double().numpy()
    for state in world.states[:3]:
        eye = ego_camera(world, state.poses["ego"]).pose[0, :3, 3].double().numpy()
        assert np.linalg.norm(rig - eye, axis=1).min() < 0.6


def test_a_world_comes_back_from_its_description():
    config = replace(CONFIG, truck_start=20.0, light=Light(azimuth=200.0))
    world = build_world(config, 3)
    again = world_from_description(json.loads(json.dumps(world_description(world))))
    assert again.config == config and again.seed == 3 and again.scenario == "intersection"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scenario": "moon"}, "world.scenario = 'moon' is not known"),
        ({"seed": -1}, "world.seed = -1 must be a whole number from 0"),
        ({"config": 3}, "world.config = 3 must be an object of settings"),
        ({"config": {"trucks": 2}}, "world.config.trucks is not a setting of this scenario"),
        ({"config": {"truck_start": "far"}}, "world.config.truck_start = 'far' must be of type float"),
        ({"config": {"light": {"azimuth": True}}}, "world.config.light.azimuth = True must be of type float"),
        ({"config": {"truck_start": 99}}, "truck_start = 99.0 is out of range"),
    ],
)
def test_a_description_that_does_not_fit_is_refused(change, message):
    description = {"scenario": "intersection", "seed": 0, "config": asdict(CONFIG)} | change
    with pytest.raises(UserError, match=message):
        world_from_description(description)
