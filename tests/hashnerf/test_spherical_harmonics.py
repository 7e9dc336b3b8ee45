"""Spherical harmonics: orthonormal, right at the axes, refused for directions that are not unit vectors."""

import math

import numpy as np
import pytest
import torch
from numpy.polynomial import Polynomial

from hashnerf.rays import unit_directions
from hashnerf.spherical_harmonics import spherical_harmonics
from tests.hashnerf.numerics import finite_gradients

AXES = torch.tensor([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])


def even_directions(count):
    """Points of a golden spiral: every stretch of height has equally many, turned by the golden angle each."""
    place = torch.arange(count, dtype=torch.float64) + 0.5
    height, angle = 1 - 2 * place / count, place * math.pi * (3 - math.sqrt(5))
    radius = (1 - height * height).sqrt()
    return torch.stack([radius * angle.cos(), radius * angle.sin(), height], dim=1)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_n14_orthonormal_on_the_sphere(degree, numeric_row):
    values = spherical_harmonics(even_directions(1_000_000).float(), degree)
    # the mean over even directions times the sphere's area 4 pi estimates the integral of products
    values = values.double()  # a million float32 terms would add their own error
    products = 4 * math.pi * (values.T @ values) / len(values)
    worst = (products - torch.eye(degree * degree, dtype=torch.float64)).abs().max().item()
    numeric_row("N14", f"products of the {degree * degree} functions of degree {degree}, 1e6 directions", worst, 5e-3)


@pytest.mark.parametrize(("degree", "count"), [(1, 1), (2, 4), (3, 9), (4, 16)])
def test_lower_degrees_are_prefixes(degree, count):
    values = spherical_harmonics(AXES, degree)
    assert values.shape == (6, count)
    assert torch.equal(values, spherical_harmonics(AXES, 4)[:, :count])


def test_n14_values_at_the_axes(numeric_row):
    up, along_x = spherical_harmonics(AXES, 4)[4], spherical_harmonics(AXES, 4)[0]
    # towards +z only m = 0 is left: Y_l0 = sqrt((2 l + 1) / (4 pi))
    expected = torch.zeros(16)
    for band in range(4):
        expected[band * band + band] = math.sqrt((2 * band + 1) / (4 * math.pi))
    worst = (up - expected).abs().max().item()
    # towards +x: Y_1,1 = -sqrt(3/(4 pi)), Y_2,0 = -sqrt(5/(16 pi)), Y_2,2 = sqrt(15/(16 pi)), Y_3,3 = -sqrt(35/(32 pi))
    golden = {3: -math.sqrt(3 / (4 * math.pi)), 6: -math.sqrt(5 / (16 * math.pi))}
    golden |= {8: math.sqrt(15 / (16 * math.pi)), 15: -math.sqrt(35 / (32 * math.pi))}
    worst = max(worst, *(abs(along_x[number].item() - value) for number, value in golden.items()))
    # bands alternate in parity
    parity = torch.cat([torch.full((2 * band + 1,), (-1.0) ** band) for band in range(4)])
    turned = spherical_harmonics(-AXES, 4) - spherical_harmonics(AXES, 4) * parity
    numeric_row("N14", "closed forms and parity at the six axes", max(worst, turned.abs().max().item()), 1e-6)


def harmonic(band, order, directions):
    """A real harmonic by its definition: the derivative of a power times a sine or cosine, in float64."""
    x, y, z = directions.double().numpy().T
    turns, angle = abs(order), np.arctan2(y, x)
    power = Polynomial([-1, 0, 1]) ** band / (2**band * math.factorial(band))
    legendre = (-1) ** turns * np.sqrt(1 - z * z) ** turns * power.deriv(band + turns)(z)
    scale = (2 * band + 1) / (4 * math.pi) * math.factorial(band - turns) / math.factorial(band + turns)
    around = 1 if order == 0 else math.sqrt(2) * (np.cos(turns * angle) if order > 0 else np.sin(turns * angle))
    return torch.from_numpy(math.sqrt(scale) * legendre * around)


def test_n14_values_by_their_definition(numeric_row):
    directions = unit_directions(torch.randn(1000, 3, dtype=torch.float64))
    every = [harmonic(band, order, directions) for band in range(4) for order in range(-band, band + 1)]
    exact = torch.stack(every, dim=1)
    numeric_row("N14", "float64 at 1000 directions", (spherical_harmonics(directions, 4) - exact).abs().max(), 1e-12)
    rounded = directions.float()
    # rounded directions are a little off the sphere, where the polynomials are the reference that is left
    worst = (spherical_harmonics(rounded, 4) - spherical_harmonics(rounded.double(), 4)).abs().max()
    numeric_row("N14", "float32 at 1000 directions", worst, 1e-6)


def test_n14_poles_have_the_gradients_of_float64(numeric_row):
    ours = finite_gradients(lambda d: spherical_harmonics(d, 4), AXES)[0]
    exact = finite_gradients(lambda d: spherical_harmonics(d, 4), AXES.double())[0]
    # the sum of 16 slopes up to 7 each
    worst = ((ours - exact).abs() / (exact.abs() + 1)).max().item()
    numeric_row("N14", "gradient at the six axes", worst, 1e-4)


def test_n14_autocast_and_half_precision_stay_float32(numeric_row):
    directions = unit_directions(torch.randn(50, 3))
    plain, at_axes = spherical_harmonics(directions, 4), spherical_harmonics(AXES, 4)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        worst = (spherical_harmonics(directions, 4) - plain).abs().max().item()
        for dtype in (torch.float16, torch.bfloat16):
            worst = max(worst, (spherical_harmonics(AXES.to(dtype), 4) - at_axes).abs().max().item())
    numeric_row("N14", "under autocast, axes in float16 and bfloat16", worst)


def test_n14_other_lengths_are_refused(numeric_row):
    bad = [[2.0, 0, 0], [0, 0, 0], [0.9, 0, 0], [math.nan, 0, 1], [math.inf, 0, 0], [1e-30, 0, 0], [1e30, 0, 0]]
    for direction in bad:
        with pytest.raises(ValueError, match="unit"):
            spherical_harmonics(torch.tensor([[1.0, 0, 0], direction]), 2)
    numeric_row("N14", "lengths 0, 1e-30, 0.9, 2, 1e30, NaN, infinite: ValueError", 0)


@pytest.mark.parametrize("degree", [0, 5])
def test_other_degrees_are_refused(degree):
    with pytest.raises(ValueError, match="degree"):
        spherical_harmonics(AXES, degree)


def test_no_directions():
    assert spherical_harmonics(torch.zeros(0, 3), 3).shape == (0, 9)


def test_gradients_against_finite_differences():
    directions = unit_directions(torch.randn(5, 3, dtype=torch.float64)).requires_grad_()
    # unit length is checked, so the step of the check must stay within the tolerance
    assert torch.autograd.gradcheck(lambda d: spherical_harmonics(d, 4), directions, eps=1e-6)
