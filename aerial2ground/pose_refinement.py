"""Small corrections of camera poses, learned with the radiance field (aerial2ground III-B).

Camera i's told pose (R, t) becomes (R exp(w_i), t + v_i): v_i metres in the world frame, w_i a rotation vector in the
camera's own frame. Moving all cameras and the field together changes no picture, so the gauge is fixed: the corrections
have zero mean (a drone that errs independently in every picture is right on average).
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from hashnerf.low_precision import without_autocast

ORIENTATION_SHARE = 0.01
"""Weight of the orientations beside the positions in a common motion."""


class PoseCorrections(nn.Module):
    """One correction per camera, zero at first."""

    def __init__(self, cameras: int, fixed_gauge: bool = True):
        super().__init__()
        self.fixed_gauge = fixed_gauge
        self.translation = nn.Parameter(torch.zeros(cameras, 3))
        self.rotation = nn.Parameter(torch.zeros(cameras, 3))

    def forward(self, poses: Float[Tensor, "n 4 4"], camera: Int[Tensor, " n"]) -> Float[Tensor, "n 4 4"]:
        """Returns corrected camera-to-world poses; differentiable in the corrections."""
        translation, rotation = self._centred(self.translation), self._centred(self.rotation)
        with torch.autocast(poses.device.type, enabled=False):  # it would multiply rotations in half precision
            turned = poses[:, :3, :3] @ rotation_matrix(rotation)[camera]
        moved = poses[:, :3, 3] + translation[camera]
        top = torch.cat([turned, moved[:, :, None]], dim=2)
        return torch.cat([top, poses[:, 3:]], dim=1)

    def _centred(self, values: Tensor) -> Tensor:
        return values - values.mean(dim=0) if self.fixed_gauge else values


def rotation_matrix(vector: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3 3"]:
    """Returns the rotations by |w| radians about w: I + a [w] + b [w]^2 with a = sin t / t, b = (1 - cos t) / t^2.

    Through unit axes, as libraries have it, gradients in float32 lose up to five digits where t is a few milliradians,
    the size of a correction. Here a and b are functions of t^2: series below 1, half angles above.
    """
    x, y, z = vector.unbind(-1)
    square = x * x + y * y + z * z
    large = square > 1
    # each branch gets an argument that is safe for it: the gradient of what `where` leaves out is computed, too
    s = torch.where(large, torch.ones_like(square), square)
    a = 1 - s / 6 * (1 - s / 20 * (1 - s / 42 * (1 - s / 72 * (1 - s / 110 * (1 - s / 156 * (1 - s / 210))))))
    b = 1 - s / 12 * (1 - s / 30 * (1 - s / 56 * (1 - s / 90 * (1 - s / 132 * (1 - s / 182 * (1 - s / 240))))))
    angle = torch.where(large, square, torch.ones_like(square)).sqrt()
    a = torch.where(large, torch.sin(angle) / angle, a)
    b = torch.where(large, 2 * (torch.sin(angle / 2) / angle).square(), b / 2)
    rows = [
        [1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y],
        [b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x],
        [b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)


@without_autocast
def rotation_angle(a: Float[Tensor, "n 3 3"], b: Float[Tensor, "n 3 3"]) -> Float[Tensor, " n"]:
    """Returns the angle between rotations, radians; exact for small angles, where an arc cosine is not."""
    between = a.transpose(1, 2) @ b
    axis = torch.stack(
        [between[:, 2, 1] - between[:, 1, 2], between[:, 0, 2] - between[:, 2, 0], between[:, 1, 0] - between[:, 0, 1]],
        dim=1,
    )
    trace = between.diagonal(dim1=1, dim2=2).sum(dim=1)
    return torch.atan2(axis.norm(dim=1), trace - 1)


def pose_errors(
    found: Float[Tensor, "n 4 4"], truth: Float[Tensor, "n 4 4"]
) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
    """Returns each camera's distance (m) and angle (rad) from the truth after the best common rigid motion.

    The common motion is a matter of the gauge: no picture tells it. It is the least-squares one of the positions (as
    the absolute trajectory error has it); orientations decide only what those leave open, for cameras in a line.
    """
    a, b = found.double(), truth.double()
    centre_a, centre_b = a[:, :3, 3].mean(dim=0), b[:, :3, 3].mean(dim=0)
    here, there = a[:, :3, 3] - centre_a, b[:, :3, 3] - centre_b
    weight = ORIENTATION_SHARE * float(there.square().sum()) + 1e-12
    moment = there.T @ here + weight * (b[:, :3, :3] @ a[:, :3, :3].transpose(1, 2)).mean(dim=0)
    u, _, vt = torch.linalg.svd(moment)
    mirrored = torch.linalg.det(u @ vt).sign()
    turn = (u * torch.stack([torch.ones_like(mirrored), torch.ones_like(mirrored), mirrored])) @ vt
    moved = here @ turn.T + centre_b
    angle = rotation_angle(turn @ a[:, :3, :3], b[:, :3, :3])
    return (moved - b[:, :3, 3]).norm(dim=1).to(found), angle.to(found)
