"""Poses on the ground and oriented boxes: metres, radians, yaw counter-clockwise from above in (-pi, pi]."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float


def wrap_angle(angle: float) -> float:
    """The same angle in (-pi, pi]."""
    wrapped = math.remainder(angle, 2 * math.pi)
    return math.pi if wrapped == -math.pi else wrapped


@dataclass(frozen=True)
class Pose:
    """Where a body stands: the point under its centre, and its heading."""

    x: float
    y: float
    z: float
    yaw: float


@dataclass(frozen=True)
class Box:
    """An oriented box: centre, size (length, width, height) and yaw."""

    center: tuple[float, float, float]
    size: tuple[float, float, float]
    yaw: float

    def corners(self) -> Float[np.ndarray, "4 2"]:
        """The footprint, counter-clockwise."""
        length, width = self.size[0] / 2, self.size[1] / 2
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        local = np.array([[length, width], [-length, width], [-length, -width], [length, -width]])
        return local @ np.array([[cos, sin], [-sin, cos]]) + np.array(self.center[:2])

    def distance(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Distance of each point to the box, 0 inside."""
        offset = points - np.array(self.center)
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        along, across = cos * offset[:, 0] + sin * offset[:, 1], cos * offset[:, 1] - sin * offset[:, 0]
        local = np.stack([along, across, offset[:, 2]], 1)
        return np.linalg.norm(np.maximum(np.abs(local) - 0.5 * np.array(self.size), 0.0), axis=1)

    def contains(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Whether each point lies in the box (its surface included)."""
        return self.distance(points) == 0.0

    def overlaps(self, other: "Box") -> bool:
        """Whether the two footprints share any area (separating axes)."""
        mine, theirs = self.corners(), other.corners()
        for yaw in (self.yaw, self.yaw + math.pi / 2, other.yaw, other.yaw + math.pi / 2):
            axis = np.array([math.cos(yaw), math.sin(yaw)])
            a, b = mine @ axis, theirs @ axis
            if a.max() <= b.min() or b.max() <= a.min():
                return False
        return True


def box_at(pose: Pose, size: tuple[float, float, float]) -> Box:
    """The box of a body of `size` that stands at `pose`."""
    return Box((pose.x, pose.y, pose.z + size[2] / 2), size, wrap_angle(pose.yaw))
