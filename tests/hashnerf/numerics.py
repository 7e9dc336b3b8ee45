"""Helpers of the numerical tests: magnitudes over the whole range of a number format, finite values and gradients."""

from collections.abc import Callable

import torch
from torch import Tensor


def all_floats(count: int, dtype: torch.dtype = torch.float32, infinities: bool = False) -> Tensor:
    """`count` magnitudes from the smallest normal to the largest number, both signs, and zero."""
    limits = torch.finfo(dtype)
    exponents = torch.linspace(*torch.tensor([limits.tiny, limits.max], dtype=torch.float64).log(), count)
    # the ends are set exactly: rounding exp(log(max)) can overflow
    magnitudes = torch.exp(exponents.double()).clamp(limits.tiny, limits.max).to(dtype)
    magnitudes = magnitudes.clamp(max=limits.max)
    values = torch.cat([-magnitudes.flip(0), torch.zeros(1, dtype=dtype), magnitudes])
    if infinities:
        ends = torch.tensor([float("inf")], dtype=dtype)
        values = torch.cat([-ends, values, ends])
    return values


def finite_gradients(function: Callable[..., Tensor], *inputs: Tensor) -> tuple[Tensor, ...]:
    """Assert that value and all gradients of sum(function(inputs)) are finite; return the gradients."""
    leaves = [value.detach().clone().requires_grad_(value.is_floating_point()) for value in inputs]
    out = function(*leaves)
    assert bool(out.isfinite().all()), "a value is not finite"
    wanted = [leaf for leaf in leaves if leaf.requires_grad]
    gradients = torch.autograd.grad(out.sum(), wanted)
    for gradient in gradients:
        assert bool(gradient.isfinite().all()), "a gradient is not finite"
    return gradients
