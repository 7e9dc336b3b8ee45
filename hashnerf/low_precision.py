"""Where bfloat16 products pay: a processor without units for them emulates each, ten to twenty times slower.

Processors with AVX-512 BF16 or AMX have such units (Intel from Cooper Lake and Sapphire Rapids on, AMD from Zen 4 on).
"""

import functools

import torch


@functools.cache
def multiplies_bfloat16(device_type: str) -> bool:
    """Returns whether a kind of device (`cpu`, `cuda`) multiplies bfloat16 in hardware; False where that is unknown."""
    if device_type == "cuda":
        return torch.cuda.is_available() and torch.cuda.is_bf16_supported(including_emulation=False)
    if device_type != "cpu":
        return False
    return torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()
