"""Rays: origins in world metres and unit directions, one row a ray."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from hashnerf.activations import at_least_float32
from hashnerf.errors import UserError


@dataclass(frozen=True)
class Rays:
    """Half lines in the world: origins in metres, directions of unit length."""

    origins: Float[Tensor, "rays 3"]
    directions: Float[Tensor, "rays 3"]

    def __len__(self) -> int:
        return self.origins.shape[0]

    def select(self, index: Int[Tensor, " chosen"] | Bool[Tensor, " rays"] | slice) -> "Rays":
        """Some of the rays: row numbers, a mask with one entry a ray, or a slice."""
        return Rays(self.origins[index], self.directions[index])


def joined(parts: Sequence[Rays]) -> Rays:
    """Returns the rays of several parts, one after the other."""
    return Rays(torch.cat([part.origins for part in parts]), torch.cat([part.directions for part in parts]))


def unit_directions(vectors: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Scales vectors of any finite magnitude to length 1; raises UserError where one is zero or not finite.

    Half-precision vectors give float32 directions: three roundings in half precision would bend them.
    """
    vectors = at_least_float32(vectors)
    # Dividing by the largest component first keeps the squares of 1e-30 and 1e20 inside float32.
    largest = vectors.detach().abs().amax(dim=-1, keepdim=True)
    if not bool(((largest > 0) & torch.isfinite(largest)).all()):
        raise UserError("a ray direction is zero or not finite; every direction needs a finite length above zero")
    scaled = vectors / largest
    return scaled / scaled.norm(dim=-1, keepdim=True)
