"""Depth as the fourth channel of a picture: the same eight bits from the reconstruction and from the car's camera.

Depth is metres along the optical axis; 0, NaN and infinity mean that nothing was hit or measured. The channel is linear
from 0 to `depth_range` metres (0..255, a step of `depth_range` / 255); 255 also stands for what lies farther and for
nothing, so that the sky, a wall out of reach and a hole of the sensor look alike.
"""

import numpy as np
from jaxtyping import Float, UInt8


def depth_channel(depth: Float[np.ndarray, "*shape"], depth_range: float) -> UInt8[np.ndarray, "*shape"]:
    """Returns depth (m) as eight bits."""
    there = np.isfinite(depth) & (depth > 0)
    share = np.where(there, depth, depth_range) / depth_range
    return np.rint(255 * np.minimum(share, 1.0)).astype(np.uint8)


def with_depth(
    rgb: UInt8[np.ndarray, "*shape 3"], depth: Float[np.ndarray, "*shape"], depth_range: float
) -> UInt8[np.ndarray, "*shape 4"]:
    """Returns pictures with their depth (m) as a fourth channel."""
    return np.concatenate([rgb, depth_channel(depth, depth_range)[..., None]], axis=-1)


def depth_of(picture: UInt8[np.ndarray, "h w c"], depth_range: float) -> Float[np.ndarray, "h w"] | None:
    """Returns the depth (m) of a picture's fourth channel, 0 where there is none up to the range; None without one."""
    if picture.shape[-1] < 4:
        return None
    channel = picture[..., 3].astype(float)
    return np.where(channel < 255, channel * depth_range / 255, 0.0)
