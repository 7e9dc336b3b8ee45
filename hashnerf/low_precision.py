"""Where bfloat16 products pay, and where half precision must not come in.

A processor without units for bfloat16 emulates each product, ten to twenty times slower. Processors with AVX-512 BF16
or AMX have such units (Intel from Cooper Lake and Sapphire Rapids on, AMD from Zen 4 on).
"""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import torch

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


@functools.cache
def multiplies_bfloat16(device_type: str) -> bool:
    """Returns whether a kind of device (`cpu`, `cuda`) multiplies bfloat16 in hardware; False where that is unknown."""
    if device_type == "cuda":
        return torch.cuda.is_available() and torch.cuda.is_bf16_supported(including_emulation=False)
    if device_type != "cpu":
        return False
    return torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()


def without_autocast(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Returns a function that computes in the precision of its arguments, whatever autocast around it asks for.

    For geometry and likelihoods, whose products need all digits, and for whole trainings. Autocast keeps its copies of
    weights until the outermost one ends, and one that is switched off counts, too: were it allowed to, half-precision
    layers inside would answer with the first step's weights at every later one.
    """

    @functools.wraps(function)
    def run(*arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
        with torch.autocast("cpu", enabled=False, cache_enabled=False):
            if not torch.cuda.is_available():
                return function(*arguments, **options)
            with torch.autocast("cuda", enabled=False, cache_enabled=False):
                return function(*arguments, **options)

    return run
