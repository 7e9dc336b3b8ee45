"""Spherical harmonics: orthonormal, right at the axes, refused for directions that are not unit vectors."""

import math

import pytest
import torch

from hashnerf.rays import unit_directions
from hashnerf.spherical_harmonics import spherical_harmonics
from tests.hashnerf.numerics import finite_gradients

AXES = torch.tensor([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])


def test_orthonormal_on_the_sphere():
    directions = unit_directions(torch.randn(1_000_000, 3))
    values = spherical_harmonics(directions, 4)
    # the mean over uniform directions times the sphere's area 4 pi estimates the integral of products
    products = 4 * math.pi * (values.T @ values) / len(values)
    assert (products - torch.eye(16)).abs().max() <= 5e-3 * 4  # sampling error of 1e6 draws is 4e-3 at four sigma
    assert (products - torch.eye(16)).abs().mean() <= 5e-3


@pytest.mark.parametrize(("degree", "count"), [(1, 1), (2, 4), (3, 9), (4, 16)])
def test_lower_degrees_are_prefixes(degree, count):
    values = spherical_harmonics(AXES, degree)
    assert values.shape == (6, count)
    assert torch.equal(values, spherical_harmonics(AXES, 4)[:, :count])


def test_values_at_the_axes():
    up, along_x = spherical_harmonics(AXES, 4)[4], spherical_harmonics(AXES, 4)[0]
    # towards +z only m = 0 is left: Y_l0 = sqrt((2 l + 1) / (4 pi))
    expected = torch.zeros(16)
    for band in range(4):
        expected[band * band + band] = math.sqrt((2 * band + 1) / (4 * math.pi))
    assert torch.allclose(up, expected, atol=1e-6)
    # towards +x: Y_1,1 = -sqrt(3/(4 pi)), Y_2,0 = -sqrt(5/(16 pi)), Y_2,2 = sqrt(15/(16 pi)), Y_3,3 = -sqrt(35/(32 pi))
    assert along_x[3].item() == pytest.approx(-math.sqrt(3 / (4 * math.pi)), rel=1e-6)
    assert along_x[6].item() == pytest.approx(-math.sqrt(5 / (16 * math.pi)), rel=1e-6)
    assert along_x[8].item() == pytest.approx(math.sqrt(15 / (16 * math.pi)), rel=1e-6)
    assert along_x[15].item() == pytest.approx(-math.sqrt(35 / (32 * math.pi)), rel=1e-6)
    # bands alternate in parity
    parity = torch.cat([torch.full((2 * band + 1,), (-1.0) ** band) for band in range(4)])
    assert torch.allclose(spherical_harmonics(-AXES, 4), spherical_harmonics(AXES, 4) * parity, atol=1e-6)


def test_poles_have_finite_gradients():
    finite_gradients(lambda d: spherical_harmonics(d, 4), AXES)


def test_autocast_and_half_precision_stay_float32():
    directions = unit_directions(torch.randn(50, 3))
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(spherical_harmonics(directions, 4), spherical_harmonics(directions, 4).float())
    rough = AXES.bfloat16()
    assert torch.equal(spherical_harmonics(rough, 4), spherical_harmonics(AXES, 4))


@pytest.mark.parametrize("bad", [[2.0, 0, 0], [0, 0, 0], [0.9, 0, 0], [math.nan, 0, 1], [math.inf, 0, 0]])
def test_other_lengths_are_refused(bad):
    with pytest.raises(ValueError, match="unit"):
        spherical_harmonics(torch.tensor([[1.0, 0, 0], bad]), 2)


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
