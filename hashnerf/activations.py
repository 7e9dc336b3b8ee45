"""Exponentials that stay finite, forward and backward; half-precision inputs are upcast, results are float32 or 64."""

import torch
from jaxtyping import Float
from torch import Tensor

EXPONENT_LIMIT = 15.0  # exp(15) = 3.27e6: far above any density that matters, far below overflow


def at_least_float32(values: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Upcast half precision to float32 and leave float32 and float64 alone."""
    return values.float() if values.dtype in (torch.float16, torch.bfloat16) else values


class _TruncatedExp(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x: Tensor) -> Tensor:
        ctx.save_for_backward(x)
        return torch.exp(at_least_float32(x).clamp(max=EXPONENT_LIMIT))

    @staticmethod
    def backward(ctx, gradient: Tensor) -> Tensor:
        # Above the limit the slope stays that of the limit, so that a density that ran away can come down again;
        # below the lower limit it does not vanish either, so that an empty cell can fill up again.
        (x,) = ctx.saved_tensors
        slope = gradient * torch.exp(at_least_float32(x).clamp(-EXPONENT_LIMIT, EXPONENT_LIMIT))
        largest = torch.finfo(x.dtype).max  # exp(15) is beyond float16
        return slope.clamp(-largest, largest).to(x.dtype)


class _OneMinusExp(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x: Tensor) -> Tensor:
        ctx.save_for_backward(x)
        return -torch.expm1(-x)

    @staticmethod
    def backward(ctx, gradient: Tensor) -> Tensor:
        # autograd's 1 - expm1 form of this slope loses every digit where expm1 saturates at -1
        (x,) = ctx.saved_tensors
        return gradient * torch.exp(-x)


def truncated_exp(x: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """exp(x), bounded above by exp(15), with a slope bounded to [exp(-15), exp(15)]."""
    return _TruncatedExp.apply(x)


def one_minus_exp(x: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """1 - exp(-x) for x >= 0 without cancellation: the opacity of an optical thickness x."""
    return _OneMinusExp.apply(at_least_float32(x))
