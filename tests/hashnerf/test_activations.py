"""Exponentials at the extremes, against float64 and by hand."""

import pytest
import torch

from hashnerf.activations import EXPONENT_LIMIT, one_minus_exp, truncated_exp
from tests.hashnerf.numerics import all_floats, finite_gradients

EXTREMES = [-1e5, -104.0, -88.0, -15.0, 0.0, 11.0, 11.1, 15.0, 88.7, 88.8, 1e4, 1e5]
HALVES = [torch.float16, torch.bfloat16]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, *HALVES])
def test_n20_truncated_exp_is_finite_and_monotone(dtype, numeric_row):
    x = torch.tensor(EXTREMES, dtype=torch.float64).to(dtype)  # in float16 the largest become infinite
    value, (gradient,) = truncated_exp(x), finite_gradients(truncated_exp, x)
    broken = (~value.isfinite()).sum() + (value.diff() < 0).sum() + (gradient < 0).sum()
    broken += (gradient > torch.tensor(EXPONENT_LIMIT).exp() * 1.01).sum()
    numeric_row("N20", f"{dtype}, x from -1e5 to 1e5: not finite, falling, or too steep", broken)
    # a density that ran away must be able to come down
    numeric_row("N20", f"{dtype}, x from 0 to 1e5: no slope", (gradient[x >= 0] == 0).sum())


def test_n20_truncated_exp_is_exact_inside_the_limits(numeric_row):
    x = torch.linspace(-15, 15, 3001)
    truth = x.double().exp()
    (gradient,) = finite_gradients(truncated_exp, x)
    for what, found, accepted in (("value", truncated_exp(x), 1e-6), ("gradient", gradient, 1e-4)):
        worst = ((found.double() - truth).abs() / truth).max()
        numeric_row("N20", f"float32, x from -15 to 15: relative error of the {what}", worst, accepted)


@pytest.mark.parametrize("function", [truncated_exp, one_minus_exp])
@pytest.mark.parametrize("dtype", HALVES)
def test_n20_n22_half_precision_is_upcast(function, dtype, numeric_row):
    x = torch.linspace(0, 11, 50).to(dtype)
    assert function(x).dtype == torch.float32
    assert torch.equal(function(x), function(x.float()))
    (half,), (single,) = finite_gradients(function, x), finite_gradients(function, x.float())
    row, cast = "N20" if function is truncated_exp else "N22", torch.finfo(dtype).eps
    # below the smallest normal number a cast keeps no relative error
    floor = torch.finfo(dtype).tiny
    worst = ((half.float() - single).abs() / single.clamp(min=floor)).max()
    numeric_row(row, f"{dtype}, x from 0 to 11: relative error of the gradient beside float32's", worst, cast)


@pytest.mark.parametrize("function", [truncated_exp, one_minus_exp])
def test_n20_n22_autocast_changes_nothing(function, numeric_row):
    x = torch.linspace(0, 10, 100)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        inside = function(x)
    assert torch.equal(inside, function(x))
    worst = ((inside - function(x)).abs() / function(x).clamp(min=1e-6)).max()
    row = "N20" if function is truncated_exp else "N22"
    numeric_row(row, "x from 0 to 10: relative change under autocast", worst, 1e-6)


def test_n22_small_opacities_do_not_cancel(numeric_row):
    expected = {
        1e-8: 9.99999995e-9,  # x - x^2/2
        1e-7: 9.9999995e-8,
        1e-5: 9.99995000017e-6,
        1e-3: 9.995001666e-4,
        1.0: 0.632120558829,  # 1 - 1/e
        20.0: 0.999999997939,
        88.0: 1.0,
        1e6: 1.0,
    }
    x = torch.tensor(list(expected))
    truth = torch.tensor(list(expected.values()), dtype=torch.float64)
    assert -torch.expm1(-x.double()) == pytest.approx(truth, rel=1e-7), "rounding the input alone moves it this far"
    worst = ((one_minus_exp(x).double() - truth).abs() / truth).max()
    numeric_row("N22", "float32, x = 1e-8 to 1e6, by hand: relative error", worst, 2e-7)


def test_n22_one_minus_exp_over_all_magnitudes(numeric_row):
    x = all_floats(200)
    x = x[x >= 0]
    (gradient,) = finite_gradients(one_minus_exp, x)
    truth = -torch.expm1(-x.double())
    worst = ((one_minus_exp(x).double() - truth).abs() / truth.clamp(min=torch.finfo(x.dtype).tiny)).max()
    numeric_row("N22", "float32, x over all magnitudes: relative error", worst, 2e-7)
    worst = (gradient.double() - torch.exp(-x.double())).abs().max()
    numeric_row("N22", "float32, x over all magnitudes: error of the gradient", worst, 1e-6)


def test_gradients_against_finite_differences():
    x = torch.linspace(0.1, 9, 20, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(truncated_exp, x)
    assert torch.autograd.gradcheck(one_minus_exp, x)
