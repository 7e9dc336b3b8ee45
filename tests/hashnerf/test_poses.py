"""What counts as a rigid camera pose, and moving far scenes to the origin."""

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hashnerf.poses import default_scene_box, nearest_rotation, read_pose, scene_origin

IDENTITY = [[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]]


def _rotation(seed):
    matrix, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return matrix * np.sign(np.linalg.det(matrix))


def _pose(rotation, position=(1.0, 2.0, 3.0)):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose.tolist()


def _changed(row, column, value):
    pose = copy.deepcopy(IDENTITY)
    pose[row][column] = value
    return pose


@pytest.mark.parametrize("decimals, error", [(5, 7.9e-6), (4, 1e-4), (16, 1e-15)])
def test_n84_rounded_rotations_are_projected(numeric_row, decimals, error):
    rotation = _rotation(0)
    pose, problem = read_pose(_pose(np.round(rotation, decimals)))
    assert problem is None
    left = np.abs(pose[:3, :3].T @ pose[:3, :3] - np.eye(3)).max()
    numeric_row("N84", f"{decimals} decimals: error of R'R that is left", left, 1e-14)
    assert np.abs(pose[:3, :3] - rotation).max() < 2 * error + 1e-15
    assert pose[:3, 3].tolist() == [1, 2, 3]


def test_n84_half_precision_rotations_are_projected(numeric_row):
    pose, problem = read_pose(_pose(_rotation(1).astype(np.float16).astype(float)))
    assert problem is None
    numeric_row("N84", "stored as float16: error left", np.abs(pose[:3, :3].T @ pose[:3, :3] - np.eye(3)).max(), 1e-14)


def test_n83_many_products_drift_and_are_projected(numeric_row):
    turn, product = _rotation(2).astype(np.float32), np.eye(3, dtype=np.float32)
    for _ in range(100_000):
        product = product @ turn
    assert np.abs(product.T @ product - np.eye(3)).max() > 1e-4, "without the projection"
    found = nearest_rotation(product.astype(float))
    numeric_row("N83", "100,000 products in float32", np.abs(found.T @ found - np.eye(3)).max(), 1e-6)
    assert np.linalg.det(found) == pytest.approx(1.0)


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 10**6))
def test_nearest_rotation_beats_every_nearby_one(seed):
    rng = np.random.default_rng(seed)
    noisy = _rotation(seed) + rng.normal(size=(3, 3)) * 1e-2
    best = nearest_rotation(noisy)
    assert np.linalg.det(best) == pytest.approx(1)
    axis = rng.normal(size=3) * 1e-3
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    other = nearest_rotation(best @ (np.eye(3) + cross))
    assert np.linalg.norm(noisy - best) <= np.linalg.norm(noisy - other)


@pytest.mark.parametrize(
    "value, sentence",
    [
        (None, "is not a list of four rows"),
        ("pose", "is not a list of four rows"),
        ([1, 2, 3, 4], "is not a list of four rows"),
        (IDENTITY[:3], "rows of the lengths [4, 4, 4]"),
        ([row[:3] for row in IDENTITY], "rows of the lengths [3, 3, 3, 3]"),
        (_changed(0, 3, "1.0"), "not a number"),
        (_changed(0, 0, True), "not a number"),
        (_changed(0, 3, None), "not a number"),
        (_changed(1, 1, float("nan")), "not finite"),
        (_changed(1, 3, float("inf")), "not finite"),
        (_changed(2, 3, 10**400), "too large for a coordinate"),
        (_changed(0, 3, 2e7), "2e+07 m from the origin"),
        (_changed(3, 3, 2.0), "last row [0.0, 0.0, 0.0, 2.0]"),
        (np.array(_pose(np.eye(3))).T.tolist(), "looks transposed"),
        (_changed(0, 0, -1.0), "mirror image (determinant -1)"),
        (_pose(1.01 * np.eye(3)), "not rigid: its axes have lengths [1.01, 1.01, 1.01]"),
        (_pose(np.eye(3) + 1e-2), "not rigid"),
        (_pose(np.zeros((3, 3))), "not rigid"),
    ],
)
def test_n84_a_bad_pose_is_named(numeric_row, value, sentence):
    pose, problem = read_pose(value)
    numeric_row("N84", f"a pose that {sentence}: taken in", pose is not None or sentence not in problem)


def test_the_origin_moves_only_far_scenes():
    near = np.array([[900.0, -900.0, 10.0], [0.0, 0.0, 0.0]])
    assert scene_origin(near).tolist() == [0, 0, 0]
    far = near + np.array([500_000.0, 4_649_776.0, 35.0])
    assert scene_origin(far).tolist() == [500_450, 4_649_326, 40]


def test_the_default_box_holds_cameras_and_what_they_see():
    # Two cameras 10 m apart look along -y: reach 10 m, margin 1 m.
    towards_minus_y = [[-1, 0, 0], [0, 0, 1], [0, 1, 0]]  # its third column, the backward axis, is +y
    poses = np.stack([np.array(_pose(towards_minus_y, (x, 0, 0))) for x in (0, 10)])
    np.testing.assert_allclose(default_scene_box(poses), [[-1, -11, -1], [11, 1, 1]])


@pytest.mark.parametrize("count", [1, 2])
def test_n123_the_default_box_of_cameras_in_one_place_has_a_volume(numeric_row, count):
    box = default_scene_box(np.stack([np.array(IDENTITY)] * count))
    off = np.abs(box - [[-0.1, -0.1, -1.1], [0.1, 0.1, 0.1]]).max()
    numeric_row("N123", f"{count} cameras in one place: scene box, metres", off, 1e-6)


def test_n123_a_camera_beyond_all_maps_is_refused(numeric_row):
    taken = [place for place in (1e9, -1e9, 1e7 + 1) if read_pose(_changed(1, 3, place))[0] is not None]
    numeric_row("N123", "one camera at 1e9 m: taken in", len(taken))
    positions = np.array([[0.0, 0.0, 0.0], [1e7, 0.0, 0.0]])
    assert np.isfinite(scene_origin(positions)).all() and np.isfinite(scene_origin(positions[:1])).all()
