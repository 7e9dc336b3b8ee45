"""The town in which a policy is tried: not quite the one that the drone saw."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8

from aerial2ground.car import CarConfig, CarState
from aerial2ground.car_camera import CarCameraConfig, car_cameras
from aerial2ground.depth_channel import with_depth
from aerial2ground.ground_truth import FLAT
from worlds.camera_effects import CameraEffects, DepthEffects, depth_measured, photographed
from worlds.mini_city import MiniCityConfig, build_mini_city
from worlds.scene import Scene, World
from worlds.shading import Light

BODY_HEIGHT = 0.15
"""Metres: what stands lower than this in the car's way is touched."""


@dataclass(frozen=True)
class DeploymentConfig:
    """What has changed since the drone flew."""

    light: Light = field(default_factory=lambda: Light(azimuth=245.0, elevation=38.0))
    """Where the sun stands now."""
    displacement: float = 0.03
    """How far small things were moved, metres."""
    camera: CameraEffects = field(default_factory=lambda: CameraEffects(0.3, 0.06, 0.02, 0.02))
    """The car's camera against the drone's."""
    depth: DepthEffects = field(default_factory=lambda: DepthEffects(0.005, 0.01))
    """The car's depth camera against the true depth; only used where the network reads depth."""


class Deployment:
    """The town as the car meets it; positions are those of a loaded data set, `origin` less than the town's own."""

    def __init__(
        self,
        town: World,
        config: DeploymentConfig,
        camera: CarCameraConfig,
        car: CarConfig,
        seed: int,
        origin: tuple[float, float] = (0.0, 0.0),
        depth: bool = False,
    ):
        assert isinstance(town.config, MiniCityConfig)
        changed = replace(town.config, light=config.light, displacement=config.displacement)
        self.world = build_mini_city(changed, town.seed)
        self.config, self.camera, self.car, self.origin = config, camera, car, np.array(origin)
        self.rng = np.random.default_rng(seed)
        # of its own, so that the colours do not depend on whether depth is looked at
        self.depth_rng = np.random.default_rng([seed, 1]) if depth else None
        self.scene = Scene(self.world, {})
        self.obstacles = _standing(self.world)

    def look(self, state: CarState) -> UInt8[np.ndarray, "h w c"]:
        """What the car's camera sees; with depth, as it is measured, in a fourth channel."""
        x, y = self.origin + state.pose[:2]
        cameras = car_cameras(self.camera, torch.tensor([[x, y, state.yaw]], dtype=torch.float64))
        view = self.scene.render(cameras)
        # a turn by d radians moves the middle of the picture by focal * d pixels
        rate = state.speed * math.tan(state.steering) / self.car.wheelbase
        rgb = photographed(view.rgb, self.config.camera, float(cameras.focal[0, 0]) * rate, self.rng)
        if self.depth_rng is None:
            return rgb
        depth = depth_measured(view.depth, self.config.depth, self.depth_rng)
        return with_depth(rgb, depth, self.camera.depth_range)

    def touches(self, corners: Float[np.ndarray, "4 2"]) -> bool:
        """Whether a body with these corners touches anything that stands in the town."""
        return bool(inside(corners + self.origin, self.obstacles).any())


def inside(corners: Float[np.ndarray, "4 2"], points: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
    """Which points lie in a convex quadrilateral given counter-clockwise."""
    result = np.ones(len(points), bool)
    for start, end in zip(corners, np.roll(corners, -1, axis=0)):
        side = (end - start)[0] * (points[:, 1] - start[1]) - (end - start)[1] * (points[:, 0] - start[0])
        result &= side >= 0
    return result


def _standing(world: World) -> Float[np.ndarray, "n 2"]:
    """Points of everything that stands, as high as a car's body reaches."""
    parts = [mesh.vertices for name, mesh in world.static if name not in FLAT]
    points = np.concatenate(parts)
    return points[points[:, 2] < BODY_HEIGHT][:, :2].astype(float)
