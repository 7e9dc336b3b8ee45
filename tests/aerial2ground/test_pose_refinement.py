"""Corrections of poses: rotations against scipy-free references, the gauge, and errors after alignment."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from aerial2ground.pose_refinement import PoseCorrections, pose_errors, rotation_angle, rotation_matrix
from hashnerf.cameras import Cameras, camera_rays
from tests.hashnerf.numerics import finite_gradients

ANGLES = [0.0, 1e-30, 1e-12, 1e-9, 1e-6, 2e-6, 1e-5, 1e-4, 1e-3, 2e-3, 5e-3, 9.9e-3, 1.01e-2, 0.05, 0.3, 0.999, 1.001]
ANGLES += [3.0, math.pi - 1e-3, math.pi, 2 * math.pi, 6.0, 40.0]
AXES = torch.tensor([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, -0.48, 0.64]], dtype=torch.float64)


def random_poses(count: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    poses = torch.eye(4).repeat(count, 1, 1)
    poses[:, :3, :3] = rotation_matrix(torch.randn(count, 3, generator=generator))
    poses[:, :3, 3] = 3 * torch.randn(count, 3, generator=generator)
    return poses


def vectors() -> torch.Tensor:
    """Rotation vectors in float32: every angle about every axis, and three tangents of several turns."""
    grid = torch.tensor(ANGLES, dtype=torch.float64)[:, None, None] * AXES
    far = torch.tensor([[20, -1, 0], [30, 5, -1], [math.pi / 2, math.pi / 2, 0]], dtype=torch.float64)
    return torch.cat([grid.reshape(-1, 3), far]).float()


def exponential(vector: torch.Tensor) -> torch.Tensor:
    """The matrix exponential of the vectors' cross products."""
    x, y, z = vector.unbind(-1)
    o = torch.zeros_like(x)
    return torch.linalg.matrix_exp(torch.stack([o, -z, y, z, o, -x, -y, x, o], dim=-1).unflatten(-1, (3, 3)))


def slopes(function, vector: torch.Tensor) -> torch.Tensor:
    """Derivatives of all nine entries by the vector."""
    vector = vector.clone().requires_grad_()
    entries = function(vector).flatten(1).unbind(1)
    return torch.stack([torch.autograd.grad(one.sum(), vector, retain_graph=True)[0] for one in entries], dim=1)


@pytest.mark.parametrize("way", [(0.0, 0.0, 0.0), (1.0, -2.0, 0.5), (1e6, 1e6, 1e6)])
def test_n80_rotations_equal_the_matrix_exponential(numeric_row, way):
    rows, moved = vectors(), torch.tensor(way)
    corrections = PoseCorrections(len(rows), fixed_gauge=False)
    with torch.no_grad():
        corrections.rotation.copy_(rows)
        corrections.translation.copy_(moved.expand(len(rows), 3))
    poses, number = torch.eye(4).repeat(len(rows), 1, 1), torch.arange(len(rows))
    plain = corrections(poses, number).detach()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(corrections(poses, number), plain), "in single precision also under autocast"
    off = (plain[:, :3, :3].double() - exponential(rows.double())).abs().max()
    assert torch.equal(plain[:, :3, 3], moved.expand(len(rows), 3))
    numeric_row("N80", f"23 angles from 0 to 40, 4 axes, moved by {way}: entries, float32", float(off), 1e-6)
    alone = torch.cat([rotation_matrix(row[None]) for row in rows])
    numeric_row("N80", "one vector alone and in a batch", float((alone - plain[:, :3, :3]).abs().max()), 1e-6)


def test_n80_gradients_are_exact_also_at_zero(numeric_row):
    rows = vectors()
    exact = slopes(exponential, rows.double())
    relative = (slopes(rotation_matrix, rows) - exact).abs().amax(dim=(1, 2)) / exact.abs().amax(dim=(1, 2))
    numeric_row("N80", "the same: slopes of all entries, float32, relative", float(relative.max()), 1e-6)
    precise = (slopes(rotation_matrix, rows.double()) - exact).abs().max()
    numeric_row("N80", "the same in float64", float(precise), 1e-12)
    for size in (0.0, 1e-8, 1e-5, 0.3, 0.57735, 0.6):
        vector = torch.full((2, 3), size, dtype=torch.float64, requires_grad=True)
        assert torch.autograd.gradcheck(rotation_matrix, vector)
    start = torch.zeros(1, 3, requires_grad=True)
    rotation_matrix(start)[0, 2, 1].backward()
    assert start.grad is not None and start.grad[0].tolist() == [1.0, 0.0, 0.0], "about x, y turns towards z"


@given(st.lists(st.floats(-50, 50, width=32), min_size=3, max_size=3))
def test_every_vector_gives_a_rotation(numbers):
    turn = rotation_matrix(torch.tensor([numbers], dtype=torch.float64))[0]
    assert (turn.T @ turn - torch.eye(3, dtype=torch.float64)).abs().max() < 1e-12
    assert float(torch.linalg.det(turn)) == pytest.approx(1.0, abs=1e-12)


def test_n81_angles_come_back_from_rotations(numeric_row):
    turns = rotation_matrix(vectors())
    here = torch.eye(3).expand(len(turns), 3, 3)
    wanted = vectors().double().norm(dim=1)
    wanted = (wanted - 2 * math.pi * (wanted / (2 * math.pi)).round()).abs()  # the short way round
    numeric_row("N81", "23 angles, 4 axes, float32", float((rotation_angle(here, turns) - wanted).abs().max()), 1e-6)
    for part in turns:
        slope = finite_gradients(rotation_angle, here[:1], part[None])
        assert max(float(one.abs().max()) for one in slope) < 1e3


def test_n82_angles_near_half_a_turn(numeric_row):
    axes = torch.nn.functional.normalize(torch.randn(100, 3, dtype=torch.float64))
    axes = torch.cat([axes, torch.eye(3, dtype=torch.float64)])
    worst = 0.0
    for less in (1e-2, 1e-3, 1e-4, 1e-6, 0.0):
        turns = rotation_matrix((math.pi - less) * axes)
        found = rotation_angle(torch.eye(3).double().expand_as(turns), turns)
        worst = max(worst, float((found - (math.pi - less)).abs().max()))
        (_, slope) = finite_gradients(rotation_angle, torch.eye(3).expand_as(turns), turns.float())
        assert float(slope.abs().max()) < 1e3
        assert float(found.max()) <= math.pi + 1e-6
    numeric_row("N82", "angle between rotations, pi less 0 to 1e-2, 103 axes", worst, 1e-5)


@pytest.mark.parametrize("degrees", [0.0, 1e-4, 0.2, 90.0, 179.9])
def test_angles_between_rotations(degrees):
    turn = rotation_matrix(torch.tensor([[0.0, 0.0, math.radians(degrees)]], dtype=torch.float64))
    base = rotation_matrix(torch.tensor([[0.3, -0.2, 0.9]], dtype=torch.float64))
    assert math.degrees(float(rotation_angle(base, base @ turn))) == pytest.approx(degrees, abs=1e-8)


def test_n85_corrections_begin_at_nothing_and_have_zero_mean(numeric_row):
    poses = random_poses(5)
    corrections = PoseCorrections(5)
    number = torch.arange(5)
    assert torch.allclose(corrections(poses, number), poses, atol=1e-6)
    with torch.no_grad():
        corrections.translation += 0.1
        corrections.rotation += 0.02
    common = float((corrections(poses, number) - poses).detach().abs().max())
    numeric_row("N85", "all cameras by 0.1 m and 0.02 rad: what is left of it", common, 1e-6)
    with torch.no_grad():
        corrections.translation.copy_(torch.randn(5, 3) + 10)
    moved = corrections(poses, number)[:, :3, 3] - poses[:, :3, 3]
    numeric_row("N85", "corrections of 10 m, mean of what is applied", float(moved.mean(dim=0).abs().max()), 1e-5)
    assert moved.abs().max() > 0.1
    free = PoseCorrections(5, fixed_gauge=False)
    with torch.no_grad():
        free.translation.fill_(1.0)
    assert torch.allclose(free(poses, number)[:, :3, 3], poses[:, :3, 3] + 1)


def test_n86_one_camera_and_one_ray(numeric_row):
    corrections, number = PoseCorrections(1, fixed_gauge=False), torch.zeros(1, dtype=torch.int64)
    pose = corrections(torch.eye(4)[None], number)
    lens = torch.tensor([[2.0, 2.0]])
    cameras = Cameras(pose, lens, lens, torch.zeros(1, 4), 4, 4)
    rays = camera_rays(cameras, number, torch.tensor([[0.5, 0.5]]))
    shapes = [pose.shape, rays.origins.shape, rays.directions.shape]
    wrong = sum(shape != wanted for shape, wanted in zip(shapes, [(1, 4, 4), (1, 3), (1, 3)]))
    numeric_row("N86", "one camera, one ray: wrong shapes", wrong)
    rays.directions[0, 0].backward()
    assert corrections.rotation.grad.shape == (1, 3) and bool(corrections.rotation.grad.any())


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
