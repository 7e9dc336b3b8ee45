"""Corrections of poses: rotations against scipy-free references, the gauge, and errors after alignment."""

import math

import pytest
import torch
from kornia.geometry.conversions import axis_angle_to_rotation_matrix as rotation_matrix

from aerial2ground.pose_refinement import PoseCorrections, pose_errors, rotation_angle


def random_poses(count: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    poses = torch.eye(4).repeat(count, 1, 1)
    poses[:, :3, :3] = rotation_matrix(torch.randn(count, 3, generator=generator))
    poses[:, :3, 3] = 3 * torch.randn(count, 3, generator=generator)
    return poses


@pytest.mark.parametrize("size", [0.0, 1e-8, 5e-5, 2e-4, 0.5, 3.0, math.pi])
def test_rotations_equal_the_matrix_exponential(size):
    vector = size * torch.nn.functional.normalize(torch.tensor([[1.0, -2.0, 0.5]], dtype=torch.float64))
    x, y, z = vector[0].tolist()
    k = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    assert torch.allclose(rotation_matrix(vector)[0], torch.linalg.matrix_exp(k), atol=1e-12)


def test_gradients_are_exact_also_at_zero():
    for size in (0.0, 1e-5, 0.3):
        vector = torch.full((2, 3), size, dtype=torch.float64, requires_grad=True)
        assert torch.autograd.gradcheck(rotation_matrix, vector)
    start = torch.zeros(1, 3, requires_grad=True)
    rotation_matrix(start)[0, 2, 1].backward()
    assert start.grad is not None and start.grad[0].tolist() == [1.0, 0.0, 0.0], "about x, y turns towards z"


@pytest.mark.parametrize("degrees", [0.0, 1e-4, 0.2, 90.0, 179.9])
def test_angles_between_rotations(degrees):
    turn = rotation_matrix(torch.tensor([[0.0, 0.0, math.radians(degrees)]], dtype=torch.float64))
    base = rotation_matrix(torch.tensor([[0.3, -0.2, 0.9]], dtype=torch.float64))
    assert math.degrees(float(rotation_angle(base, base @ turn))) == pytest.approx(degrees, abs=1e-8)


def test_corrections_begin_at_nothing_and_have_zero_mean():
    poses = random_poses(5)
    corrections = PoseCorrections(5)
    number = torch.arange(5)
    assert torch.allclose(corrections(poses, number), poses, atol=1e-6)
    with torch.no_grad():
        corrections.translation.copy_(torch.randn(5, 3) + 10)
    moved = corrections(poses, number)[:, :3, 3] - poses[:, :3, 3]
    assert moved.mean(dim=0).abs().max() < 1e-5 and moved.abs().max() > 0.1
    free = PoseCorrections(5, fixed_gauge=False)
    with torch.no_grad():
        free.translation.fill_(1.0)
    assert torch.allclose(free(poses, number)[:, :3, 3], poses[:, :3, 3] + 1)


def test_a_common_motion_is_no_error():
    truth = random_poses(12)
    turn = rotation_matrix(torch.tensor([[0.1, 0.4, -0.2]]))[0]
    moved = truth.clone()
    moved[:, :3, :3] = turn @ truth[:, :3, :3]
    moved[:, :3, 3] = truth[:, :3, 3] @ turn.T + torch.tensor([1.0, -2.0, 3.0])
    metres, radians = pose_errors(moved, truth)
    assert metres.max() < 1e-5 and radians.max() < 1e-5


def test_cameras_in_a_line_are_aligned_by_their_orientations():
    truth = random_poses(6)
    truth[:, :3, 3] = torch.linspace(-1, 1, 6)[:, None] * torch.tensor([1.0, 2.0, 0.5])
    turn = rotation_matrix(torch.tensor([[0.3, 0.6, 0.2]]))[0]
    moved = truth.clone()
    moved[:, :3, :3], moved[:, :3, 3] = turn @ truth[:, :3, :3], truth[:, :3, 3] @ turn.T
    metres, radians = pose_errors(moved, truth)
    assert metres.max() < 1e-5 and radians.max() < 1e-5


def test_errors_of_single_cameras_are_measured():
    truth = random_poses(200)
    found = truth.clone()
    found[0, :3, 3] += torch.tensor([0.2, 0.0, 0.0])
    found[1, :3, :3] = truth[1, :3, :3] @ rotation_matrix(torch.tensor([[0.1, 0.0, 0.0]]))[0]
    metres, radians = pose_errors(found, truth)
    assert float(metres[0]) == pytest.approx(0.2, rel=0.02) and float(radians[1]) == pytest.approx(0.1, rel=0.02)
    assert metres[2:].max() < 0.01 and radians[2:].max() < 0.01
