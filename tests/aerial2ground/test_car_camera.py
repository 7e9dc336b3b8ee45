"""The car's camera: where the road lies in its picture."""

import math

import pytest
import torch

from aerial2ground.car_camera import CarCameraConfig, car_cameras
from hashnerf.cameras import project
from hashnerf.errors import UserError

LEVEL = CarCameraConfig(pitch=0.0, ahead=0.2, above_road=0.1, field_of_view=90.0, width=96, height=54)


def test_points_by_hand():
    cameras = car_cameras(LEVEL, torch.tensor([[1.0, 2.0, math.pi / 2]]), road_height=0.5)
    assert cameras.pose[0, :3, 3].tolist() == pytest.approx([1.0, 2.2, 0.6])
    # 1 m ahead of the camera: on the axis, 0.1 m below it, and 0.5 m to the right; the focal length is 48 px
    points = torch.tensor([[1.0, 3.2, 0.6], [1.0, 3.2, 0.5], [1.5, 3.2, 0.6]])
    pixel, depth = project(cameras, torch.zeros(3, dtype=torch.int64), points)
    assert pixel.tolist() == [pytest.approx(p, abs=1e-4) for p in ([48, 27], [48, 31.8], [72, 27])]
    assert depth == pytest.approx(torch.ones(3))


def test_pitch_and_tilt_turn_the_camera_up():
    config = CarCameraConfig(pitch=-6.0)
    poses = torch.zeros(2, 3)
    tilt = torch.tensor([[0.0, 0.0], [0.02, math.radians(2.0)]])
    cameras = car_cameras(config, poses, tilt=tilt)
    up = torch.rad2deg(torch.asin(-cameras.pose[:, 2, 2]))
    assert up.tolist() == pytest.approx([-6.0, -4.0], abs=1e-4)
    assert cameras.pose[:, 2, 3].tolist() == pytest.approx([0.12, 0.14])
    rotation = cameras.pose[:, :3, :3]
    assert torch.allclose(rotation @ rotation.transpose(1, 2), torch.eye(3).expand(2, 3, 3), atol=1e-6)
    assert torch.linalg.det(rotation) == pytest.approx(torch.ones(2))


@pytest.mark.parametrize(
    "changes", [{"width": 4}, {"field_of_view": 180.0}, {"above_road": 0.0}, {"pitch": 90.0}, {"depth_range": 0.0}]
)
def test_bad_settings_are_named(changes):
    with pytest.raises(UserError, match="camera"):
        CarCameraConfig(**changes)
