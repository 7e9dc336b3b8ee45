"""Poses of a car along a path, on it and off it: what a training set needs to show (III-C, Alg. 2).

Most are disturbed as a drive disturbs them; some stand on the wrong side of the road and some nearly off it, where no
collected drive would have been.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from aerial2ground.paths import Path
from hashnerf.errors import UserError


@dataclass(frozen=True)
class DisturbanceConfig:
    """How far poses stray from the path."""

    lateral: float = 0.08
    """Standard deviation across the path, metres."""
    heading: float = 8.0
    """Standard deviation of the heading, degrees."""
    height: float = 0.005
    """Standard deviation of the camera's height, metres."""
    pitch: float = 1.0
    """Standard deviation of the camera's pitch, degrees."""
    wrong_side: float = 0.03
    """Share of poses on the other lane. In a junction there is none: what such poses teach contradicts the others."""
    near_accident: float = 0.03
    """Share of poses at the edge of the road, heading off it."""
    lane: float = 0.35
    """Width of a lane, metres."""

    def __post_init__(self):
        for key in ("lateral", "heading", "height", "pitch", "lane"):
            if not 0 <= getattr(self, key) < math.inf:
                raise UserError(f"disturbance.{key} is {getattr(self, key)}; give 0 or a positive number")
        for key in ("wrong_side", "near_accident"):
            if not 0 <= getattr(self, key) <= 1:
                raise UserError(f"disturbance.{key} is {getattr(self, key)}; give a share from 0 to 1")
        if self.wrong_side + self.near_accident > 1:
            raise UserError("disturbance.wrong_side and near_accident exceed 1 together; give smaller shares")


@dataclass(frozen=True)
class GroundPoses:
    """Poses of the car and what moves its camera besides."""

    poses: Float[np.ndarray, "n 3"]
    """(x, y, yaw) of the rear axle, traffic keeping to the right."""
    tilt: Float[np.ndarray, "n 2"]
    """Metres up and radians up of the camera."""
    arc: Float[np.ndarray, " n"]
    """Arc length of the undisturbed place on the path."""


def disturbed_poses(path: Path, count: int, config: DisturbanceConfig, rng: np.random.Generator) -> GroundPoses:
    """Draws `count` poses spread evenly along the path."""
    arc = (np.arange(count) + rng.uniform(0, 1, count)) / count * path.length
    left = config.lateral * rng.standard_normal(count)
    turn = np.radians(config.heading) * rng.standard_normal(count)
    kind = rng.permutation(count)
    other = kind < round(config.wrong_side * count)
    edge = ~other & (kind < round((config.wrong_side + config.near_accident) * count))
    # right-hand traffic: the other lane lies to the left, the road's edge half a lane to the right
    left = left + np.where(other, config.lane, 0.0)
    side = rng.choice((-1.0, 1.0), count)
    left = np.where(edge, side * config.lane * rng.uniform(0.35, 0.6, count), left)
    turn = np.where(edge, side * np.radians(rng.uniform(5.0, 25.0, count)), turn)
    poses = shifted(path.poses(arc), left, turn)
    tilt = np.column_stack(
        [config.height * rng.standard_normal(count), np.radians(config.pitch) * rng.standard_normal(count)]
    )
    return GroundPoses(poses, tilt, arc)


def shifted(
    poses: Float[np.ndarray, "n 3"], left: Float[np.ndarray, " n"], turn: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3"]:
    """Returns poses moved to their left (m) and turned left (rad)."""
    x, y, yaw = poses.T
    return np.column_stack([x - left * np.sin(yaw), y + left * np.cos(yaw), yaw + turn])
