"""Volume rendering of samples along rays, in log space.

Notation: sigma (1/m) density, dt (m) length of a sample's interval, x = sigma*dt its optical thickness, T the
transmittance in front of a sample, w = T*(1-exp(-x)) its weight, opacity = sum of w. Samples are padded: an unused
place has dt = 0 and then contributes exactly nothing, whatever its density. Everything runs in float32 or float64, also
under autocast.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from hashnerf.activations import at_least_float32, one_minus_exp
from hashnerf.low_precision import without_autocast

MAX_THICKNESS = 1e3  # exp(-1000) is zero even in float64: a thicker sample changes nothing
MAX_FACTOR = 1e30  # bound on density and on length, so that no product is inf * 0
MIN_OPACITY = 1e-3  # below this opacity a ray has no depth


def sample_weights(
    density: Float[Tensor, "rays samples"], dt: Float[Tensor, "rays samples"]
) -> tuple[Float[Tensor, "rays samples"], Float[Tensor, " rays"]]:
    """Return each sample's weight and the transmittance behind the last one (weights + transmittance sum to 1)."""
    density = at_least_float32(density).clamp(0, MAX_FACTOR)
    dt = at_least_float32(dt).clamp(0, MAX_FACTOR)
    thickness = (density * dt).clamp(max=MAX_THICKNESS)
    # exclusive sum by shifting: subtracting a thick sample from an inclusive sum would lose the thin ones before it
    total = torch.cumsum(thickness, dim=1)
    before = torch.cat([total.new_zeros(len(total), 1), total], dim=1)
    transmittance = torch.exp(-before)
    return transmittance[:, :-1] * one_minus_exp(thickness), transmittance[:, -1]


class _WeightedSum(torch.autograd.Function):
    """Sum of weighted colours; autocast would multiply in half precision, forward and backward."""

    @staticmethod
    @without_autocast
    def forward(ctx, weights: Tensor, rgb: Tensor) -> Tensor:
        ctx.save_for_backward(weights, rgb)
        return torch.matmul(weights[:, None, :], rgb)[:, 0, :]

    @staticmethod
    @torch.autograd.function.once_differentiable
    @without_autocast
    def backward(ctx, gradient: Tensor) -> tuple[Tensor | None, Tensor | None]:
        weights, rgb = ctx.saved_tensors
        for_weights, for_rgb = ctx.needs_input_grad
        return (
            torch.matmul(rgb, gradient[:, :, None])[:, :, 0] if for_weights else None,
            weights[:, :, None] * gradient[:, None, :] if for_rgb else None,
        )


def composite_colour(
    weights: Float[Tensor, "rays samples"], rgb: Float[Tensor, "rays samples 3"], background: Float[Tensor, "rays 3"]
) -> Float[Tensor, "rays 3"]:
    """Blend sample colours by weight over a background that fills what opacity is missing."""
    weights, rgb, background = (at_least_float32(value) for value in (weights, rgb, background))
    opacity = weights.sum(dim=1, keepdim=True)
    colour = _WeightedSum.apply(weights, rgb)
    # rounding can lift opacity a little above 1: the background may not turn negative. Colour and opacity are sums in
    # different orders, so their quotient or the sum of both parts may still pass 1, but only where all is as good as
    # white: no gradient of any worth is lost there
    return (colour / opacity.clamp(min=1) + (1 - opacity).clamp(min=0) * background).clamp(max=1)


def expected_depth(
    weights: Float[Tensor, "rays samples"], t: Float[Tensor, "rays samples"]
) -> tuple[Float[Tensor, " rays"], Bool[Tensor, " rays"]]:
    """Return the mean distance of what a ray hits (m) and whether it hits anything; inf where it does not.

    Between two half-transparent surfaces the mean lies where nothing is: see `median_depth`.
    """
    weights, t = at_least_float32(weights), at_least_float32(t)
    opacity = weights.sum(dim=1)
    valid = opacity >= MIN_OPACITY
    depth = (weights * t).sum(dim=1) / torch.where(valid, opacity, 1.0)
    return torch.where(valid, depth, torch.inf), valid


def median_depth(
    weights: Float[Tensor, "rays samples"], t: Float[Tensor, "rays samples"]
) -> tuple[Float[Tensor, " rays"], Bool[Tensor, " rays"]]:
    """Return the distance at which half of the light is stopped (m) and whether it ever is; inf where it is not."""
    weights, t = at_least_float32(weights), at_least_float32(t)
    # the small tolerance lets a surface of weight exactly one half, summed with rounding, count
    reached = torch.cumsum(weights, dim=1) >= 0.5 - 1e-6
    valid = reached.any(dim=1)
    if t.shape[1] == 0:
        return torch.full_like(t.sum(dim=1), torch.inf), valid
    first = reached.to(torch.uint8).argmax(dim=1, keepdim=True)
    return torch.where(valid, t.gather(1, first)[:, 0], torch.inf), valid
