"""Rays and projection against hand-worked pixels, each other, OpenCV, and finite differences."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hashnerf.cameras import Cameras, any_sees, camera_rays, image_rays, look_at, project
from hashnerf.errors import UserError
from hashnerf.rays import unit_directions


def _cameras(poses, distortion=(0.0, 0.0, 0.0, 0.0), width=4, height=2, focal=(2.0, 2.0), centre=(2.0, 1.0)):
    count = len(poses)
    return Cameras(
        pose=torch.stack(poses),
        focal=torch.tensor([focal] * count),
        centre=torch.tensor([centre] * count),
        distortion=torch.tensor([distortion] * count),
        width=width,
        height=height,
    )


def _photo_cameras(distortion):
    poses = [look_at((8, 3, 2), (0, 0, 1)), look_at((-2.0, 9.0, 30.0), (1, 1, 0)), look_at((5, 5, 5), (0, 0, 0))]
    return _cameras(poses, distortion, 640, 480, (500.0, 505.0), (322.0, 236.5))


def test_rays_of_a_four_by_two_image_worked_by_hand():
    # Identity pose, f = 2, centre (2, 1). Pixel row 0 column 0 has its centre at (.5, .5):
    # x = (.5 - 2)/2 = -.75, y = (.5 - 1)/2 = -.25 (up in the image), so the OpenGL direction is (-.75, +.25, -1).
    rays = image_rays(_cameras([torch.eye(4)]), 0)
    assert len(rays) == 8
    expected = torch.tensor([[-0.75, 0.25, -1], [-0.25, 0.25, -1], [0.25, 0.25, -1], [0.75, 0.25, -1]])
    expected = torch.cat([expected, expected * torch.tensor([1.0, -1.0, 1.0])])
    torch.testing.assert_close(rays.directions, expected / expected.norm(dim=1, keepdim=True))
    assert not rays.origins.any()


def test_a_car_camera_sees_left_on_the_left():
    # The camera looks along world +x from 1 m up: left of the car is +y, and must land left of the centre, up above it.
    cameras = _cameras([look_at((0, 0, 1), (10, 0, 1))])
    points = torch.tensor([[10.0, 0, 1], [10.0, 5, 1], [10.0, 0, 3], [-10.0, 0, 1]])
    pixel, depth = project(cameras, torch.zeros(4, dtype=torch.int64), points)
    # f/z = .2 pixels a metre: 5 m left is 1 pixel left, 2 m up is .4 pixels up.
    torch.testing.assert_close(pixel[:3], torch.tensor([[2.0, 1], [1.0, 1], [2.0, 0.6]]))
    assert torch.isnan(pixel[3]).all()
    torch.testing.assert_close(depth, torch.tensor([10.0, 10, 10, -10]))


@pytest.mark.parametrize(
    "distortion", [(0.0, 0, 0, 0), (-0.1, 0.02, 1e-3, -2e-3), (0.5, 0.2, 0, 0), (-0.35, 0.15, 0, 0)]
)
def test_n122_projection_inverts_rays_to_a_thousandth_of_a_pixel(numeric_row, distortion):
    cameras = _photo_cameras(tuple(map(float, distortion)))
    generator = torch.Generator().manual_seed(3)
    index = torch.randint(3, (2000,), generator=generator)
    pixel = torch.rand(2000, 2, generator=generator) * torch.tensor([640.0, 480.0])
    rays = camera_rays(cameras, index, pixel)
    distance = 1 + 50 * torch.rand(2000, 1, generator=generator)
    again, depth = project(cameras, index, rays.origins + distance * rays.directions)
    numeric_row("N122", f"2000 pixels through the lens {distortion}", float((again - pixel).abs().max()), 1e-3)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        low = camera_rays(cameras, index, pixel)
        assert torch.equal(low.directions, rays.directions), "in single precision also under autocast"
        assert torch.equal(project(cameras, index, rays.origins + distance * rays.directions)[0], again)
    forward = -cameras.pose[index, :3, 2]
    torch.testing.assert_close(depth, distance[:, 0] * (rays.directions * forward).sum(-1), rtol=1e-4, atol=1e-4)


def test_projection_agrees_with_opencv():
    cameras = _photo_cameras((-0.1, 0.02, 1e-3, -2e-3))
    points = torch.rand(50, 3, generator=torch.Generator().manual_seed(0)) * 2 - 1
    pixel, _ = project(cameras, torch.zeros(50, dtype=torch.int64), points)
    # OpenCV wants world-to-camera with y down and z forward.
    world_to_camera = np.diag([1.0, -1, -1, 1]) @ np.linalg.inv(cameras.pose[0].double().numpy())
    matrix = np.array([[500.0, 0, 322], [0, 505, 236.5], [0, 0, 1]])
    turn, _ = cv2.Rodrigues(world_to_camera[:3, :3])
    lens = np.array([-0.1, 0.02, 1e-3, -2e-3])
    expected, _ = cv2.projectPoints(points.double().numpy(), turn, world_to_camera[:3, 3], matrix, lens)
    np.testing.assert_allclose(pixel.numpy(), expected[:, 0], atol=1e-3)


def test_a_lens_that_folds_is_refused_at_the_pixel_and_hidden_in_projection():
    cameras = _photo_cameras((-0.6, 0.0, 0.0, 0.0))
    index = torch.zeros(1, dtype=torch.int64)
    with pytest.raises(UserError, match=r"camera 0 cannot be inverted at pixel \[0.5, 0.5\]"):
        camera_rays(cameras, index, torch.tensor([[0.5, 0.5]]))
    # 60 degrees off axis (tan = 1.73 > .745) would fold back to a radius of 1.73 (1 - .6 * 3) = -1.4: nowhere real.
    pose = cameras.pose[0]
    off_axis = pose[:3, 3] - pose[:3, 2] + 3**0.5 * pose[:3, 0]
    pixel, depth = project(cameras, index, off_axis[None])
    assert torch.isnan(pixel).all() and float(depth) == pytest.approx(1, abs=1e-5)


def test_n121_scaling_moves_a_point_with_the_image(numeric_row):
    # With centres at +.5, a point at pixel (u, v) lands at (u/4, v/2) in an image a quarter as wide and half as high.
    cameras = _photo_cameras((-0.1, 0.02, 1e-3, -2e-3))
    small = cameras.scaled(160, 240)
    index = torch.zeros(1, dtype=torch.int64)
    points = torch.tensor([[0.5, -0.2, 1.3]])
    full, _ = project(cameras, index, points)
    shrunk, _ = project(small, index, points)
    torch.testing.assert_close(shrunk * torch.tensor([4.0, 2.0]), full)
    off = max(
        float((a * torch.tensor([4.0, 2.0]) - b).abs().max())
        for a, b in ((small.focal, cameras.focal), (small.centre, cameras.centre))
    )
    numeric_row("N121", "a quarter as wide, half as high: focal length and centre", off, 0.0)
    assert (small.width, small.height) == (160, 240)


def test_selecting_keeps_rows_in_order():
    cameras = _photo_cameras((0.0, 0.0, 0.0, 0.0))
    assert torch.equal(cameras.select([2, 0]).pose, cameras.pose[[2, 0]])
    assert torch.equal(cameras.select(torch.tensor([1])).pose, cameras.pose[1:2])
    assert len(cameras.select(slice(0, 2))) == 2 and len(cameras.select([])) == 0
    assert cameras.to("cpu").is_pinhole


@pytest.mark.parametrize("width, height", [(0, 4), (4, -1)])
def test_an_image_without_pixels_is_refused(width, height):
    with pytest.raises(UserError, match="at least one pixel"):
        _cameras([torch.eye(4)], width=width, height=height)


@pytest.mark.parametrize("distortion", [(0.0, 0.0, 0.0, 0.0), (-0.1, 0.02, 1e-3, -2e-3)])
def test_gradients_with_respect_to_the_pose(distortion):
    cameras = _photo_cameras(distortion)
    index = torch.tensor([0, 2])
    pixel = torch.tensor([[10.0, 20.0], [400.0, 300.0]])
    points = torch.tensor([[0.0, 0.5, 1.0], [0.2, 0.1, -0.3]], dtype=torch.float64)

    def rays_and_projection(pose):
        moved = replace(cameras, pose=pose)
        rays = camera_rays(moved, index, pixel)
        return rays.origins, rays.directions, *project(moved, index, points)

    pose = cameras.pose.double().requires_grad_()
    assert torch.autograd.gradcheck(rays_and_projection, (pose,), eps=1e-7, atol=1e-3, rtol=1e-4)


def test_points_behind_the_camera_do_not_poison_the_gradient():
    cameras = _photo_cameras((-0.1, 0.02, 1e-3, -2e-3))
    pose = cameras.pose.requires_grad_()
    points = torch.stack([pose.detach()[0, :3, 3], torch.tensor([1e30, 0.0, 0.0]), torch.zeros(3)])
    pixel, _ = project(replace(cameras, pose=pose), torch.zeros(3, dtype=torch.int64), points)
    assert torch.isnan(pixel[:2]).all()
    pixel[2].sum().backward()
    assert torch.isfinite(pose.grad).all()


@settings(deadline=None, max_examples=60)
@given(st.lists(st.floats(-100, 100), min_size=6, max_size=6))
def test_look_at_is_a_rigid_pose_facing_the_target(numbers):
    position, target = numbers[:3], numbers[3:]
    level = np.hypot(position[0] - target[0], position[1] - target[1])
    if level < 1e-3:
        return
    pose = look_at(position, target).double()
    torch.testing.assert_close(pose[:3, :3].T @ pose[:3, :3], torch.eye(3, dtype=torch.float64), atol=1e-6, rtol=0)
    assert float(torch.linalg.det(pose[:3, :3])) == pytest.approx(1, abs=1e-5)
    facing = unit_directions(torch.tensor(target, dtype=torch.float64) - torch.tensor(position, dtype=torch.float64))
    torch.testing.assert_close(-pose[:3, 2], facing, atol=1e-6, rtol=0)
    assert float(pose[2, 1]) >= -1e-6 and abs(float(pose[2, 0])) < 1e-6  # up is up, right is level


@pytest.mark.parametrize(
    "position, target, sentence",
    [
        ((1, 2, 3), (1, 2, 3), "must be finite and differ"),
        ((0.0, 0.0, float("nan")), (1, 0, 0), "must be finite"),
        ((1, 2, 30), (1, 2, 0), "runs along up"),
    ],
)
def test_look_at_refuses_views_without_an_orientation(position, target, sentence):
    with pytest.raises(UserError, match=sentence):
        look_at(position, target)


def test_looking_straight_down_works_with_another_up():
    pose = look_at((1, 2, 30), (1, 2, 0), up=(0, 1, 0))
    torch.testing.assert_close(pose[:3, :3], torch.eye(3))


@pytest.mark.parametrize(
    "low, high, seen",
    [
        ([1.0, -1.0, -1.0], [2.0, 1.0, 1.0], True),
        ([-2.0, -1.0, -1.0], [-1.0, 1.0, 1.0], False),  # behind
        ([4.0, 1.0, -0.5], [5.0, 2.0, 0.5], True),  # beside the axis, in the left half of the picture
        ([4.0, 6.0, -0.5], [5.0, 7.0, 0.5], False),  # beyond the left edge, at y = x
        ([-3.0, -3.0, -3.0], [9.0, 9.0, 9.0], True),  # around the camera
        ([5.0, -0.01, -0.01], [5.01, 0.01, 0.01], True),  # smaller than a pixel
    ],
)
def test_a_box_is_seen_in_front_of_a_camera_only(low, high, seen):
    camera = _cameras([look_at((0, 0, 0), (1, 0, 0)).float()], height=4, centre=(2.0, 2.0))  # 90 degrees wide and high
    assert any_sees(camera, torch.tensor([low, high])) == seen
