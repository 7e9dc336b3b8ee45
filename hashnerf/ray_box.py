"""Where rays enter and leave an axis-aligned box: distances in metres along unit directions from the origin."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

PARALLEL = 1e-12  # a direction component this small moves a ray by less than a micrometre in 1,000 km


def intersect_box(
    origins: Float[Tensor, "rays 3"],
    directions: Float[Tensor, "rays 3"],
    box: Float[Tensor, "2 3"],
    near_min: float = 0.0,
) -> tuple[Float[Tensor, " rays"], Float[Tensor, " rays"], Bool[Tensor, " rays"]]:
    """Return (near, far, hit) of each ray, with near >= near_min and far >= near always.

    A ray that misses, or only grazes an edge or corner (zero length), is no hit and has far == near. Computed in
    float64: an origin may lie 10,000 box sizes away; beyond that the float32 result may round to zero length and
    count as a miss. Raises ValueError for a zero direction.
    """
    if bool((directions == 0).all(dim=1).any()):
        raise ValueError("a ray direction is zero")
    origin, direction = origins.double(), directions.double()
    low, high = box.double()
    parallel = direction.abs() < PARALLEL
    # A parallel ray never crosses the two planes: it is between them for ever, or never. Dividing would give 0 * inf.
    inverse = 1 / torch.where(parallel, 1.0, direction)
    first, second = (low - origin) * inverse, (high - origin) * inverse
    between = (origin >= low) & (origin <= high)
    enter = torch.where(parallel, torch.where(between, -torch.inf, torch.inf), torch.minimum(first, second))
    leave = torch.where(parallel, torch.where(between, torch.inf, -torch.inf), torch.maximum(first, second))
    near = enter.amax(dim=1).clamp(min=near_min)
    far = leave.amin(dim=1)
    missed = ~(far >= near)  # a ray that is not a number misses, too
    near = torch.where(missed, near_min, near).to(origins.dtype)
    far = torch.where(missed, near_min, far).to(origins.dtype)
    return near, far, far > near
