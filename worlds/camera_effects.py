"""What a real camera does to a picture: exposure, white balance, noise, motion blur; and a stereo camera to depth.

Each has a name.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, UInt8

from worlds.checks import check_between

GAMMA = 2.2


@dataclass(frozen=True)
class CameraEffects:
    """How a camera differs from the renderer's ideal one; all zero changes nothing."""

    exposure: float = 0.0
    """Stops: +1 doubles the light."""
    warmth: float = 0.0
    """White balance: share by which red rises and blue falls."""
    noise: float = 0.0
    """Standard deviation of pixel noise, as a share of full scale."""
    shutter: float = 0.0
    """Seconds that the shutter is open: what moves in the picture is blurred."""

    def __post_init__(self) -> None:
        check_between("camera.exposure", self.exposure, -3.0, 3.0)
        check_between("camera.warmth", self.warmth, -0.5, 0.5)
        check_between("camera.noise", self.noise, 0.0, 0.3)
        check_between("camera.shutter", self.shutter, 0.0, 0.2)


@dataclass(frozen=True)
class DepthEffects:
    """How a stereo camera's depth differs from the true one; all zero changes nothing."""

    noise: float = 0.0
    """Standard deviation of 1 / depth (per metre): so many metres at 1 m, and four times as many at 2 m."""
    holes: float = 0.0
    """Share of the pixels in which nothing is measured."""

    def __post_init__(self) -> None:
        check_between("depth.noise", self.noise, 0.0, 1.0)
        check_between("depth.holes", self.holes, 0.0, 1.0)


def photographed(
    rgb: UInt8[np.ndarray, "h w 3"], effects: CameraEffects, pixels_per_second: float, rng: np.random.Generator
) -> UInt8[np.ndarray, "h w 3"]:
    """The picture as a camera takes it whose image moves sideways by `pixels_per_second` (a turning car's does)."""
    light = (rgb.astype(np.float32) / 255) ** np.float32(GAMMA)
    light = blurred(light, abs(pixels_per_second) * effects.shutter)
    gain = 2.0**effects.exposure * np.array([1 + effects.warmth, 1.0, 1 - effects.warmth], np.float32)
    value = np.clip(light * gain.astype(np.float32), 0.0, 1.0) ** np.float32(1 / GAMMA)
    if effects.noise:
        value = value + effects.noise * rng.standard_normal(value.shape, dtype=np.float32)
    return np.rint(255 * np.clip(value, 0.0, 1.0)).astype(np.uint8)


def depth_measured(
    depth: Float32[np.ndarray, "h w"], effects: DepthEffects, rng: np.random.Generator
) -> Float32[np.ndarray, "h w"]:
    """The depth (m along the axis, 0 where nothing is) as a stereo camera measures it; what it loses becomes 0."""
    seen = depth > 0
    inverse = 1 / np.where(seen, depth, 1.0)
    if effects.noise:
        inverse = inverse + effects.noise * rng.standard_normal(depth.shape, dtype=np.float32)
    if effects.holes:
        seen = seen & (rng.random(depth.shape) >= effects.holes)
    seen = seen & (inverse > 0)
    return np.where(seen, 1 / np.where(seen, inverse, 1.0), 0.0).astype(np.float32)


def blurred(light: np.ndarray, length: float) -> np.ndarray:
    """The mean over a sideways motion of `length` pixels; border pixels are repeated."""
    if length < 0.1:
        return light
    reach = int(np.ceil(length / 2))
    offsets = np.arange(-reach, reach + 1)
    weight = np.clip(length / 2 + 0.5 - np.abs(offsets), 0.0, 1.0)
    padded = np.pad(light, ((0, 0), (reach, reach), (0, 0)), mode="edge")
    width = light.shape[1]
    parts = [w * padded[:, reach + o : reach + o + width] for o, w in zip(offsets, weight) if w > 0]
    return (np.sum(parts, axis=0) / weight.sum()).astype(np.float32)
