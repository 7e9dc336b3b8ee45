"""What may be known of a scene besides its pictures: distances of surfaces, and points where nothing stands."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from hashnerf.field import Field
from hashnerf.render import Rendering

BEND = 0.05
"""Metres up to which an error of distance counts by its square."""


def distance_error(seen: Rendering, distance: Float[Tensor, " rays"]) -> Float[Tensor, ""]:
    """Return the mean error of known distances (m, Huber); NaN is not known, and a ray that hits nothing counts not."""
    known = distance.isfinite() & seen.depth_valid
    # both arguments are made safe: an infinity that is only masked afterwards still reaches the gradient
    found, wanted = torch.where(known, seen.depth, 0.0), torch.where(known, distance, 0.0)
    error = nn.functional.huber_loss(found, wanted, reduction="none", delta=BEND) / BEND
    return error.sum() / known.sum().clamp(min=1)


def standing(field: Field, points: Float[Tensor, "points 3"]) -> Float[Tensor, ""]:
    """Return the mean optical thickness that the finest cells at some points have, on a logarithmic scale.

    The opacity itself would have no slope where all is opaque, which is where it matters most.
    """
    edge = (field.box[1] - field.box[0]).amax() / (field.config.finest_resolution * field.config.flatness)
    return torch.log1p(field.density(points)[0] * edge).mean()
