"""Checking camera-to-world poses as they come from disk: 4x4, float64, metres, OpenGL axes."""

import numpy as np
from jaxtyping import Float

ROTATION_TOLERANCE = 1e-3  # text with few digits and fp16 storage stay below 4e-4; a scaled or sheared matrix does not
LARGEST_TRANSLATION = 1e7  # metres: every projected map coordinate (UTM northing) fits below
ORIGIN_THRESHOLD = 1e3  # metres: a float32 coordinate of this size is exact to 0.06 mm


def read_pose(value: object) -> tuple[Float[np.ndarray, "4 4"] | None, str | None]:
    """The pose in a JSON value with its rotation made exactly orthonormal, or the reason why it is not one."""
    if not isinstance(value, list) or not all(isinstance(row, list) for row in value):
        return None, "is not a list of four rows"
    if [len(row) for row in value] != [4, 4, 4, 4]:
        return None, f"has rows of the lengths {[len(row) for row in value][:8]} instead of four rows of four numbers"
    if not all(isinstance(number, (int, float)) and not isinstance(number, bool) for row in value for number in row):
        return None, "holds something that is not a number"
    try:
        pose = np.array(value, dtype=np.float64)
    except OverflowError:
        return None, "holds an integer too large for a coordinate"
    problem = _pose_problem(pose)
    if problem is not None:
        return None, problem
    pose[:3, :3] = nearest_rotation(pose[:3, :3])
    return pose, None


def _pose_problem(pose: Float[np.ndarray, "4 4"]) -> str | None:
    if not np.isfinite(pose).all():
        return "holds a number that is not finite"
    if np.abs(pose[3] - [0, 0, 0, 1]).max() > 1e-6:
        hint = " (the matrix looks transposed)" if np.abs(pose[:, 3] - [0, 0, 0, 1]).max() <= 1e-6 else ""
        return f"has the last row {pose[3].tolist()} instead of [0, 0, 0, 1]{hint}"
    if np.abs(pose[:3, 3]).max() > LARGEST_TRANSLATION:
        return f"is {np.abs(pose[:3, 3]).max():.3g} m from the origin, beyond {LARGEST_TRANSLATION:.0e} m"
    rotation = pose[:3, :3]
    error = np.abs(rotation.T @ rotation - np.eye(3)).max()
    if error > ROTATION_TOLERANCE:
        lengths = np.linalg.norm(rotation, axis=0)
        return f"is not rigid: its axes have lengths {np.round(lengths, 4).tolist()} and R'R is off by {error:.2g}"
    if np.linalg.det(rotation) < 0:
        return "is a mirror image (determinant -1): one axis has the wrong sign"
    return None


def nearest_rotation(matrix: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """The rotation closest to a nearly orthonormal matrix (polar decomposition by SVD)."""
    left, _, right = np.linalg.svd(matrix)
    return left @ right


def default_scene_box(poses: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "2 3"]:
    """A box for files that state none: all cameras, and what lies ahead of each within the span of the cameras.

    Loose on purpose; a data set that states its own `scene_box` spends no capacity on empty space. One camera, or
    cameras in one place, see 1 m ahead.
    """
    positions, ahead = poses[:, :3, 3], -poses[:, :3, 2]
    span = np.linalg.norm(positions.max(axis=0) - positions.min(axis=0))
    reach = span if span > 1e-9 else 1.0
    points = np.concatenate([positions, positions + reach * ahead])
    margin = 0.1 * reach  # keeps a flat arrangement from making a flat box
    return np.stack([points.min(axis=0) - margin, points.max(axis=0) + margin])


def scene_origin(positions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " 3"]:
    """What to subtract before casting to float32: zero near the origin, else the mean position in whole metres."""
    if np.abs(positions).max() <= ORIGIN_THRESHOLD:
        return np.zeros(3)
    return np.round(positions.mean(axis=0))
