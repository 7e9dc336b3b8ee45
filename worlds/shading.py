"""Light and colour: one sun with hard shadows, a sky that is brighter near the horizon, gamma at the end.

All colours are linear float32 until `to_uint8`; directions are unit vectors, z up.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, UInt8

from worlds.checks import check_between
from worlds.raycast import Caster

SUN = np.array([2.5, 2.35, 2.05], np.float32)
SKY = np.array([0.70, 0.80, 0.98], np.float32)
BOUNCE = np.array([0.30, 0.28, 0.25], np.float32)
"""Irradiance over pi of the sun (facing it), of the sky (facing up) and of the ground (facing down)."""
ZENITH = np.array([0.22, 0.42, 0.80], np.float32)
HORIZON = np.array([0.72, 0.78, 0.84], np.float32)
HAZE = np.array([0.50, 0.53, 0.52], np.float32)


@dataclass(frozen=True)
class Light:
    """Where the sun stands."""

    azimuth: float = 215.0
    """Degrees counter-clockwise from +x."""
    elevation: float = 48.0
    """Degrees above the horizon."""

    def __post_init__(self) -> None:
        check_between("light.azimuth", self.azimuth, -360.0, 360.0)
        check_between("light.elevation", self.elevation, 10.0, 90.0)

    @property
    def direction(self) -> Float32[np.ndarray, " 3"]:
        """Unit vector towards the sun."""
        azimuth, elevation = np.deg2rad(self.azimuth), np.deg2rad(self.elevation)
        flat = np.cos(elevation)
        return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], np.float32)


def sky_colour(directions: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
    """Radiance of the sky (above) and of the haze (below the horizon): a function of direction only."""
    z = directions[:, 2:3]
    up = np.sqrt(np.clip(z, 0.0, 1.0))
    down = np.clip(-z * 12.0, 0.0, 1.0)
    return (HORIZON + (ZENITH - HORIZON) * up + (HAZE - HORIZON) * down).astype(np.float32)


def mottle(points: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, " n"]:
    """Smooth noise in [-1, 1] with wavelengths of 2 to 9 m: coarse enough to survive a 128 px image."""
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    bend = np.sin(np.float32(0.47) * x - np.float32(0.39) * y + np.float32(0.5))
    coarse = np.sin(np.float32(0.35) * x + np.float32(0.71) * y + np.float32(0.9) * z + np.float32(2.2) * bend)
    fine = np.sin(np.float32(2.1) * x - np.float32(0.8) * y + np.float32(1.9) * z + np.float32(2.5) * coarse)
    return np.float32(0.55) * coarse + np.float32(0.45) * fine


class FaceLight:
    """Outgoing radiance of every face of a caster, split into the sun's share and the rest.

    Normals are per face, so both shares are; a ray only looks them up, multiplies by its mottling and its shadow.
    """

    def __init__(self, caster: Caster, light: Light):
        mesh, normal = caster.mesh, caster.normal
        facing = np.maximum(normal @ light.direction, 0.0)[:, None]
        upward = 0.5 + 0.5 * normal[:, 2:3]
        self.sun = (mesh.colour * facing * SUN).astype(np.float32)
        self.ambient = (mesh.colour * (upward * SKY + (1.0 - upward) * BOUNCE)).astype(np.float32)
        self.sunlit = facing[:, 0] > 0.0
        self.grain, self.gloss, self.normal = mesh.grain, mesh.gloss, normal


def to_uint8(linear: Float32[np.ndarray, "... 3"]) -> UInt8[np.ndarray, "... 3"]:
    """Exposure, a soft shoulder and gamma 2.2, then rounding to 8 bits."""
    value = np.float32(0.85) * linear
    value = value / (np.float32(1.0) + np.float32(0.18) * value)
    return np.rint(np.float32(255.0) * np.clip(value, 0.0, 1.0) ** np.float32(1.0 / 2.2)).astype(np.uint8)
