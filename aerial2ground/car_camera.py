"""The forward camera of the car: where it sits and what its pictures look like (metres, radians)."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from hashnerf.cameras import Cameras
from hashnerf.errors import UserError


@dataclass(frozen=True)
class CarCameraConfig:
    """A pinhole camera over the middle of the car (a ZED 2i at 1/10 scale, rectified)."""

    width: int = 96
    """Pixels across."""
    height: int = 54
    """Pixels down."""
    field_of_view: float = 100.0
    """Degrees across."""
    above_road: float = 0.12
    """Metres above the road."""
    ahead: float = 0.15
    """Metres ahead of the rear axle, which is where the car's pose is."""
    pitch: float = -6.0
    """Degrees above the horizon."""
    depth_range: float = 4.0
    """Metres that a depth channel tells apart; only used where the network reads depth."""

    def __post_init__(self):
        for key in ("width", "height"):
            if getattr(self, key) < 8:
                raise UserError(f"camera.{key} is {getattr(self, key)}; give at least 8 pixels")
        if not 10 <= self.field_of_view <= 150:
            raise UserError(f"camera.field_of_view is {self.field_of_view}; give 10 to 150 degrees")
        if not 0 < self.above_road < 10:
            raise UserError(f"camera.above_road is {self.above_road}; give a positive number of metres")
        if not 0 < self.depth_range <= 65:
            raise UserError(f"camera.depth_range is {self.depth_range}; give more than 0 and at most 65 metres")
        if not -80 <= self.pitch <= 80:
            raise UserError(f"camera.pitch is {self.pitch}; give -80 to 80 degrees")


def car_cameras(
    config: CarCameraConfig,
    poses: Float[Tensor, "n 3"],
    road_height: float | Float[Tensor, " n"] = 0.0,
    tilt: Float[Tensor, "n 2"] | None = None,
) -> Cameras:
    """Returns the camera of a car at each pose (x, y, yaw); `tilt` adds metres up and radians up."""
    x, y, yaw = poses.double().unbind(dim=1)
    up, pitch_change = (torch.zeros_like(x), torch.zeros_like(x)) if tilt is None else tilt.double().unbind(dim=1)
    pitch = math.radians(config.pitch) + pitch_change
    forward = torch.stack([pitch.cos() * yaw.cos(), pitch.cos() * yaw.sin(), pitch.sin()], dim=1)
    right = torch.stack([yaw.sin(), -yaw.cos(), torch.zeros_like(yaw)], dim=1)
    above = torch.linalg.cross(right, forward, dim=1)
    eye = torch.stack(
        [x + config.ahead * yaw.cos(), y + config.ahead * yaw.sin(), road_height + config.above_road + up], dim=1
    )
    pose = torch.zeros(len(x), 4, 4, dtype=torch.float64)
    pose[:, :3, 0], pose[:, :3, 1], pose[:, :3, 2], pose[:, :3, 3] = right, above, -forward, eye
    pose[:, 3, 3] = 1
    focal = 0.5 * config.width / math.tan(math.radians(config.field_of_view) / 2)
    count = len(x)
    centre = torch.tensor([[config.width / 2, config.height / 2]]).repeat(count, 1)
    focals = torch.full((count, 2), focal)
    return Cameras(pose.float(), focals, centre, torch.zeros(count, 4), config.width, config.height)
