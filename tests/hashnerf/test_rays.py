"""Unit directions over the whole float range, and selecting rays."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hashnerf.errors import UserError
from hashnerf.rays import Rays, unit_directions

COMPONENT = st.floats(min_value=-(2.0**100), max_value=2.0**100, width=32)


@pytest.mark.parametrize(
    "vector, expected",
    [
        ([3.0, 0.0, 4.0], [0.6, 0.0, 0.8]),  # 3-4-5
        ([1e-30, 0.0, 0.0], [1.0, 0.0, 0.0]),  # its square underflows float32
        ([1e-20, 1e-20, 0.0], [0.5**0.5, 0.5**0.5, 0.0]),
        ([1e20, 0.0, 0.0], [1.0, 0.0, 0.0]),  # its square overflows float32
        ([0.0, -3e38, 3e38], [0.0, -(0.5**0.5), 0.5**0.5]),
        ([1e-42, 0.0, -1e-42], [0.5**0.5, 0.0, -(0.5**0.5)]),  # subnormal
    ],
)
def test_extreme_magnitudes_become_unit_length(vector, expected):
    result = unit_directions(torch.tensor([vector]))
    torch.testing.assert_close(result, torch.tensor([expected]), atol=1e-6, rtol=0)


@pytest.mark.parametrize("vector", [[0.0, 0.0, 0.0], [torch.nan, 0.0, 0.0], [0.0, torch.inf, 0.0]])
def test_zero_and_non_finite_directions_are_refused(vector):
    with pytest.raises(UserError, match="direction is zero or not finite"):
        unit_directions(torch.tensor([[1.0, 0.0, 0.0], vector]))


@given(st.tuples(COMPONENT, COMPONENT, COMPONENT).filter(any))
def test_any_direction_keeps_its_sense_and_gets_length_one(vector):
    result = unit_directions(torch.tensor([vector]))[0].double()
    reference = torch.tensor(vector, dtype=torch.float64)
    assert abs(float(result.norm()) - 1) <= 1e-6
    torch.testing.assert_close(result, reference / reference.norm(), atol=1e-6, rtol=0)


def test_gradient_matches_finite_differences():
    vectors = torch.tensor([[0.3, -2.0, 5.0], [1e-3, 2e-3, 0.0]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(unit_directions, (vectors,), eps=1e-7)


def test_gradient_is_at_most_one_over_the_length():
    # d(v/|v|)/dv = (I - vv'/|v|^2)/|v|: along x the derivative of y is 1/|v| = 1e10, along x itself 0.
    vector = torch.tensor([[1e-10, 0.0, 0.0]], requires_grad=True)
    unit_directions(vector)[0, 1].backward()
    torch.testing.assert_close(vector.grad, torch.tensor([[0.0, 1e10, 0.0]]), rtol=1e-5, atol=0)


def test_rays_are_selected_by_rows_mask_and_slice():
    rays = Rays(torch.arange(9.0).reshape(3, 3), torch.eye(3))
    assert len(rays) == 3
    assert rays.select(torch.tensor([2, 0])).origins.tolist() == [[6, 7, 8], [0, 1, 2]]
    assert rays.select(torch.tensor([False, True, False])).directions.tolist() == [[0, 1, 0]]
    assert len(rays.select(slice(1, None))) == 2
