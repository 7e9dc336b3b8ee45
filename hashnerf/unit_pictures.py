"""Pictures in one range: float64 in [0, 1], whatever they were stored as."""

import numpy as np
from jaxtyping import Float, Shaped

RANGE_SLACK = 1e-4


def unit_pictures(pictures: Shaped[np.ndarray, "*batch h w 3"]) -> Float[np.ndarray, "*batch h w 3"]:
    """Pictures as float64 in [0, 1] from uint8 or unit floats; raises ValueError for any other range, NaN included."""
    if pictures.dtype == np.uint8:
        return pictures / 255.0
    pictures = pictures.astype(np.float64)
    if not (pictures.min(initial=0.0) >= -RANGE_SLACK and pictures.max(initial=0.0) <= 1 + RANGE_SLACK):
        raise ValueError(
            f"pictures must be uint8 or floats in [0, 1], got values from {pictures.min():.4g} to {pictures.max():.4g}"
        )
    return pictures
