"""Real spherical harmonics of viewing directions: unit vectors in the world frame."""

import torch
from jaxtyping import Float
from torch import Tensor

from hashnerf.activations import at_least_float32

MAX_DEGREE = 4
UNIT_TOLERANCE = 1e-3


def spherical_harmonics(directions: Float[Tensor, "n 3"], degree: int) -> Float[Tensor, "n {degree*degree}"]:
    """Evaluate the first `degree` bands (degree^2 values, orthonormal on the sphere) at unit directions.

    Raises ValueError for a degree outside 1..4 and for directions that are not unit vectors.
    """
    if not 1 <= degree <= MAX_DEGREE:
        raise ValueError(f"spherical harmonics degree {degree}: use 1 to {MAX_DEGREE}")
    directions = at_least_float32(directions)
    x, y, z = directions.unbind(dim=1)
    xx, yy, zz = x * x, y * y, z * z
    if not bool(((xx + yy + zz - 1).abs() < UNIT_TOLERANCE).all()):
        raise ValueError("spherical harmonics need unit directions")
    values = [torch.full_like(x, 0.28209479177387814)]
    if degree > 1:
        values += [-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x]
    if degree > 2:
        values += [
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (3 * zz - 1),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (xx - yy),
        ]
    if degree > 3:
        values += [
            0.5900435899266435 * y * (yy - 3 * xx),
            2.890611442640554 * x * y * z,
            0.4570457994644657 * y * (1 - 5 * zz),
            0.3731763325901154 * z * (5 * zz - 3),
            0.4570457994644657 * x * (1 - 5 * zz),
            1.445305721320277 * z * (xx - yy),
            0.5900435899266435 * x * (3 * yy - xx),
        ]
    return torch.stack(values, dim=1)
