"""Exponentials at the extremes, against float64 and by hand."""

import pytest
import torch

from hashnerf.activations import EXPONENT_LIMIT, one_minus_exp, truncated_exp
from tests.hashnerf.numerics import all_floats, finite_gradients

EXTREMES = [-1e5, -104.0, -88.0, -15.0, 0.0, 11.0, 11.1, 15.0, 88.7, 88.8, 1e4, 1e5]
HALVES = [torch.float16, torch.bfloat16]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, *HALVES])
def test_truncated_exp_is_finite_and_monotone(dtype):
    x = torch.tensor(EXTREMES, dtype=torch.float64).clamp(-6e4, 6e4).to(dtype)
    (gradient,) = finite_gradients(truncated_exp, x)
    value = truncated_exp(x)
    assert (value.diff() >= 0).all()
    assert (gradient[x >= 0] > 0).all(), "a density that ran away must be able to come down"
    assert gradient.max() <= torch.tensor(EXPONENT_LIMIT).exp() * 1.01


def test_truncated_exp_is_exact_inside_the_limits():
    x = torch.linspace(-15, 15, 3001)
    truth = x.double().exp()
    assert ((truncated_exp(x).double() - truth).abs() <= 1e-6 * truth).all()
    (gradient,) = finite_gradients(truncated_exp, x)
    assert ((gradient.double() - truth).abs() <= 1e-4 * truth).all()


@pytest.mark.parametrize("function", [truncated_exp, one_minus_exp])
@pytest.mark.parametrize("dtype", HALVES)
def test_half_precision_is_upcast(function, dtype):
    x = torch.linspace(0, 11, 50).to(dtype)
    assert function(x).dtype == torch.float32
    assert torch.equal(function(x), function(x.float()))


@pytest.mark.parametrize("function", [truncated_exp, one_minus_exp])
def test_autocast_changes_nothing(function):
    x = torch.linspace(0, 10, 100)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        inside = function(x)
    assert torch.equal(inside, function(x))


@pytest.mark.parametrize(
    ("x", "expected"),
    [
        (1e-8, 9.99999995e-9),  # x - x^2/2
        (1e-7, 9.9999995e-8),
        (1e-5, 9.99995000017e-6),
        (1e-3, 9.995001666e-4),
        (1.0, 0.632120558829),  # 1 - 1/e
        (20.0, 0.999999997939),
        (88.0, 1.0),
        (1e6, 1.0),
    ],
)
def test_small_opacities_do_not_cancel(x, expected):
    assert one_minus_exp(torch.tensor([x])).item() == pytest.approx(expected, rel=2e-7)


def test_one_minus_exp_over_all_magnitudes():
    x = all_floats(200)
    x = x[x >= 0]
    value = one_minus_exp(x)
    (gradient,) = finite_gradients(one_minus_exp, x)
    truth = -torch.expm1(-x.double())
    assert ((value.double() - truth).abs() <= 2e-7 * truth).all()
    assert ((gradient.double() - torch.exp(-x.double())).abs() <= 1e-6).all()


def test_gradients_against_finite_differences():
    x = torch.linspace(0.1, 9, 20, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(truncated_exp, x)
    assert torch.autograd.gradcheck(one_minus_exp, x)
