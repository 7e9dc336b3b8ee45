"""Unit directions over the whole float range, and selecting rays."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hashnerf.errors import UserError
from hashnerf.rays import Rays, unit_directions

COMPONENT = st.floats(min_value=-(2.0**100), max_value=2.0**100, width=32)


EXTREMES = (
    [3.0, 0.0, 4.0],
    [1e-30, 0.0, 0.0],  # its square underflows float32
    [1e-20, 1e-20, 0.0],
    [1e20, 0.0, 0.0],  # its square overflows float32
    [0.0, -3e38, 3e38],
    [1e-42, 0.0, -1e-42],  # subnormal
)
HALVES = {torch.float16: 1e-3, torch.bfloat16: 8e-3}


def exact_unit(vectors):
    """Directions and their Jacobians (I - uu')/|v| in float64."""
    vectors = vectors.double()
    length = vectors.norm(dim=-1, keepdim=True)
    unit = vectors / length
    jacobian = torch.eye(3, dtype=torch.float64) - unit[:, :, None] * unit[:, None]
    return unit, jacobian / length[:, :, None]


def test_n13_extreme_magnitudes_become_unit_length(numeric_row):
    vectors = torch.tensor(EXTREMES)
    result, (exact, _) = unit_directions(vectors).double(), exact_unit(vectors)
    assert result[0].tolist() == pytest.approx([0.6, 0.0, 0.8])  # 3-4-5
    numeric_row("N13", "1e-42 to 3e38: length against 1", (result.norm(dim=1) - 1).abs().max().item(), 1e-6)
    numeric_row("N13", "1e-42 to 3e38: components against float64", (result - exact).abs().max().item(), 1e-6)


def test_n13_a_gradient_is_at_most_one_over_the_length(numeric_row):
    # without the subnormal vector and the greatest one, whose gradients float32 cannot hold
    vectors = torch.tensor([*EXTREMES[:4], [1e-10, 0.0, 0.0], [3e15, -4e15, 1.0]])
    leaf = vectors.clone().requires_grad_()
    rows = [torch.autograd.grad(unit_directions(leaf)[:, axis].sum(), leaf)[0] for axis in range(3)]
    (_, exact), length = exact_unit(vectors), vectors.double().norm(dim=1)
    jacobian = torch.stack(rows, dim=1).double()
    numeric_row(
        "N13", "1e-30 to 1e20: gradient times length", (torch.linalg.matrix_norm(jacobian, 2) * length).max(), 1 + 1e-6
    )
    numeric_row(
        "N13", "error of the gradient times length", ((jacobian - exact).abs().amax(dim=(1, 2)) * length).max(), 1e-4
    )


def test_n13_zero_and_non_finite_directions_are_refused(numeric_row):
    bad = [
        [0.0, 0.0, 0.0],
        [torch.nan, 0.0, 0.0],
        [0.0, torch.inf, 0.0],
        [-0.0, 0.0, -0.0],
        [1.0, -torch.inf, torch.nan],
    ]
    for vector in bad:
        with pytest.raises(UserError, match="direction is zero or not finite"):
            unit_directions(torch.tensor([[1.0, 0.0, 0.0], vector]))
    numeric_row("N13", "zero, NaN and infinities: UserError", 0)


def test_n13_half_precision_is_upcast(numeric_row):
    worst = 0.0
    for dtype, one_cast in HALVES.items():
        vectors = (torch.randn(10_000, 3) * torch.exp(3 * torch.randn(10_000, 1))).to(dtype)
        vectors = vectors[(vectors != 0).any(dim=1) & vectors.isfinite().all(dim=1)]
        plain = unit_directions(vectors.float())
        with torch.autocast("cpu", dtype=torch.bfloat16):
            result = unit_directions(vectors)
            assert torch.equal(unit_directions(vectors.float()), plain)
        allowed = one_cast * plain.abs() + 1e-6
        worst = max(worst, ((result.float() - plain).abs() / allowed).max().item())
    numeric_row("N13", "float16 and bfloat16 vectors: error over that of one cast", worst, 1.0)


@given(st.tuples(COMPONENT, COMPONENT, COMPONENT).filter(any))
def test_any_direction_keeps_its_sense_and_gets_length_one(vector):
    result = unit_directions(torch.tensor([vector]))[0].double()
    reference = torch.tensor(vector, dtype=torch.float64)
    assert abs(float(result.norm()) - 1) <= 1e-6
    torch.testing.assert_close(result, reference / reference.norm(), atol=1e-6, rtol=0)


def test_gradient_matches_finite_differences():
    vectors = torch.tensor([[0.3, -2.0, 5.0], [1e-3, 2e-3, 0.0]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(unit_directions, (vectors,), eps=1e-7)


def test_rays_are_selected_by_rows_mask_and_slice():
    rays = Rays(torch.arange(9.0).reshape(3, 3), torch.eye(3))
    assert len(rays) == 3
    assert rays.select(torch.tensor([2, 0])).origins.tolist() == [[6, 7, 8], [0, 1, 2]]
    assert rays.select(torch.tensor([False, True, False])).directions.tolist() == [[0, 1, 0]]
    assert len(rays.select(slice(1, None))) == 2
