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


LADDER = (torch.float32, torch.float16, torch.bfloat16)
"""Number formats from the finest to the coarsest."""


def relative_error(value: Tensor, reference: Tensor) -> float:
    """Greatest deviation from a float64 reference, as a share of the reference's greatest magnitude."""
    return float((value.double() - reference).abs().max() / reference.abs().max())


def ladder_errors(function: Callable[..., Tensor], *inputs: Tensor) -> list[float]:
    """Error of function(inputs) for inputs rounded to each format of LADDER, beside float64 with nothing rounded."""
    with torch.autocast("cpu", enabled=False):
        reference = function(*(value.double() for value in inputs))
        return [relative_error(function(*(value.to(dtype) for value in inputs)), reference) for dtype in LADDER]


def change_under_autocast(function: Callable[..., Tensor], *inputs: Tensor) -> float:
    """Greatest change of function(inputs), in float32, when either half precision is asked for around it."""
    with torch.autocast("cpu", enabled=False):
        plain = function(*inputs)
    changes = []
    for dtype in LADDER[1:]:
        with torch.autocast("cpu", dtype=dtype, cache_enabled=False):
            changes.append(float((function(*inputs) - plain).abs().max()))
    return max(changes)
