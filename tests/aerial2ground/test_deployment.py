"""The town at deployment: changed as configured, and solid."""

import math

import numpy as np
import torch

from aerial2ground.car import CarConfig, CarState, footprint
from aerial2ground.car_camera import CarCameraConfig, car_cameras
from aerial2ground.deployment import Deployment, DeploymentConfig, inside
from aerial2ground.depth_channel import depth_channel
from worlds.camera_effects import CameraEffects, DepthEffects
from worlds.mini_city import MiniCityConfig, build_mini_city
from worlds.mini_city_roads import trajectories
from worlds.polylines import resampled
from worlds.shading import Light

TOWN = build_mini_city(MiniCityConfig(), 0)
SMALL = CarCameraConfig(width=32, height=18)
ON_THE_ROAD = CarState(1.9, 0.575, 0.0, 0.8)


def test_without_shifts_it_is_the_town_that_the_drone_saw():
    same = Deployment(TOWN, DeploymentConfig(Light(), 0.0, CameraEffects()), SMALL, CarConfig(), 0)
    assert all(np.array_equal(a.vertices, b.vertices) for (_, a), (_, b) in zip(TOWN.static, same.world.static))
    other = Deployment(TOWN, DeploymentConfig(), SMALL, CarConfig(), 0)
    assert (same.look(ON_THE_ROAD) != other.look(ON_THE_ROAD)).any()
    assert other.look(ON_THE_ROAD).shape == (18, 32, 3)


def test_noise_follows_the_seed():
    looks = [Deployment(TOWN, DeploymentConfig(), SMALL, CarConfig(), seed).look(ON_THE_ROAD) for seed in (1, 1, 2)]
    assert np.array_equal(looks[0], looks[1]) and not np.array_equal(looks[0], looks[2])


def test_depth_is_a_fourth_channel_and_leaves_the_colours_alone():
    plain = Deployment(TOWN, DeploymentConfig(), SMALL, CarConfig(), 0)
    deep = Deployment(TOWN, DeploymentConfig(), SMALL, CarConfig(), 0, depth=True)
    for _ in range(3):
        colours, both = plain.look(ON_THE_ROAD), deep.look(ON_THE_ROAD)
        assert both.shape == (18, 32, 4) and np.array_equal(both[..., :3], colours)
    assert (both[..., 3] == 255).any() and (np.diff(both[-1, 8:24, 3].astype(int)) != 0).any()


def test_without_effects_the_depth_is_the_towns_own():
    changed = DeploymentConfig(depth=DepthEffects())
    town = Deployment(TOWN, changed, SMALL, CarConfig(), 0, depth=True)
    cameras = car_cameras(SMALL, torch.tensor([[1.9, 0.575, 0.0]]))
    depth = town.scene.render(cameras).depth
    assert np.array_equal(town.look(ON_THE_ROAD)[..., 3], depth_channel(depth, SMALL.depth_range))


def test_the_lanes_are_free_and_houses_are_not():
    town, car = Deployment(TOWN, DeploymentConfig(), SMALL, CarConfig(), 0), CarConfig()
    for line in trajectories().values():
        fine = resampled(line, 0.1)
        along = np.diff(fine, axis=0)
        for point, yaw in zip(fine, np.arctan2(along[:, 1], along[:, 0])):
            assert not town.touches(footprint(np.array([*point, yaw]), car))
    house = next(mesh for name, mesh in TOWN.static if name.startswith("house"))
    x, y = house.bounds.mean(axis=0)[:2]
    assert town.touches(footprint(np.array([x - 0.3, y, 0.0]), car))


def test_inside_a_turned_square():
    square = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)], float)
    points = np.array([(0, 0), (0.49, 0.49), (0.51, 0.51), (-0.9, 0), (0, 1.1)])
    assert inside(square, points).tolist() == [True, True, False, True, False]
    assert math.isclose(
        float(inside(square, np.random.default_rng(0).uniform(-1, 1, (20_000, 2))).mean()), 0.5, abs_tol=0.02
    )
