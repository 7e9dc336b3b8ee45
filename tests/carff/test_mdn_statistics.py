"""What the mixture network stores about inputs and targets: exact far from zero, and finite where nothing varies."""

import math

import torch

from carff.beliefs import Belief
from carff.mdn import MDN, SMALLEST_INPUT_SCALE, SMALLEST_TARGET_SCALE


def test_n125_the_spread_of_latents_far_from_zero(numeric_row):
    generator = torch.Generator().manual_seed(0)
    means = 1000 + 1e-3 * torch.randn(4096, 2, generator=generator)
    beliefs = Belief(means, torch.full_like(means, -12.0))
    mdn = MDN(2, 2, width=8)
    mdn.set_statistics(beliefs, beliefs)
    exact = (means.double().var(dim=0, correction=0) + math.exp(-12)).sqrt()
    off = ((mdn.target_scale.double() - exact) / exact).abs().max()
    numeric_row("N125", "latents of mean 1000 and spread 1e-3 in float32: scale, relative", float(off), 1e-3)


def test_n124_nothing_varies(numeric_row):
    for count in (1, 2):
        same = Belief(torch.full((count, 2), 3.0), torch.full((count, 2), -12.0))
        mdn = MDN(2, 2, width=8)
        mdn.set_statistics(same, same)
        small = (mdn.input_scale < SMALLEST_INPUT_SCALE).sum() + (mdn.target_scale < SMALLEST_TARGET_SCALE).sum()
        unsound = sum(int((~one.isfinite()).sum()) for one in mdn.buffers())
        numeric_row("N124", f"{count} equal beliefs: scales that are too small or not finite", int(small) + unsound)
