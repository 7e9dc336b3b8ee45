"""The hash grid against a slow reference, in cells of several shapes, with no points and many; its refusals."""

import itertools
import math

import pytest
import torch

from hashnerf.errors import UserError
from hashnerf.hash_grid import HashGrid, plan_levels
from tests.hashnerf.numerics import finite_gradients

BOX = torch.tensor([[-2.0, 1.0, 0.0], [2.0, 4.0, 0.5]])


def small_grid(features=2, compile=False, log2_table_size=8, dtype=torch.float32, flatness=1.0) -> HashGrid:
    grid = HashGrid(BOX, 3, features, log2_table_size, 4, 16, compile, flatness)
    torch.nn.init.uniform_(grid.table, -1, 1)
    return grid.to(dtype)


def points(count, dtype=torch.float32):
    return BOX[0].to(dtype) + torch.rand(count, 3, dtype=dtype) * (BOX[1] - BOX[0]).to(dtype)


def slow_encode(grid: HashGrid, point: list[float]) -> list[float]:
    """One point, one level, one vertex at a time, in Python numbers."""
    out = []
    for level in grid.plan:
        table = grid.rows(grid.table, level).tolist()
        flat = (1.0, 1.0, grid.flatness)
        x = [(p - low) * stretch / level.cell for p, low, stretch in zip(point, grid.box[0].tolist(), flat)]
        cell = [min(math.floor(v), count - 2) for v, count in zip(x, level.vertices)]
        total = [0.0] * grid.features
        for corner in itertools.product((0, 1), repeat=3):
            vertex = [c + k for c, k in zip(cell, corner)]
            weight = math.prod(v - c if k else 1 - (v - c) for v, c, k in zip(x, cell, corner))
            if level.hashed:
                mixed = vertex[0] ^ (vertex[1] * 2654435761) ^ (vertex[2] * 805459861)
                row = (mixed & 0xFFFFFFFF) % level.entries
            else:
                row = vertex[0] + level.vertices[0] * (vertex[1] + level.vertices[1] * vertex[2])
            total = [t + weight * f for t, f in zip(total, table[row])]
        out += total
    return out


def test_cells_are_cubes_in_a_flat_box():
    levels = plan_levels((80.0, 60.0, 10.0), 3, 2, 17, 16, 64)
    # resolutions 16, 32, 64 along 80 m: cells of 5, 2.5 and 1.25 m
    assert [level.cell for level in levels] == [5.0, 2.5, 1.25]
    assert levels[0].vertices == (17, 13, 3)
    assert levels[2].vertices == (65, 49, 9)


@pytest.mark.parametrize("features", [2, 4])
def test_against_the_slow_reference(features):
    grid = small_grid(features)
    assert {level.hashed for level in grid.plan} == {True, False}
    places = points(40)
    truth = torch.tensor([slow_encode(grid, place) for place in places.tolist()])
    assert torch.allclose(grid(places), truth, atol=2e-5)


@pytest.mark.parametrize("features", [2, 4])
def test_the_compilers_kernels_equal_the_librarys(features, monkeypatch):
    grid, places = small_grid(features), points(300).requires_grad_()
    pull = torch.randn(300, grid.out_features)
    plain = torch.autograd.grad(grid(places), (grid.table, places), pull)
    # run without the compiler: the arithmetic is the same
    monkeypatch.setattr("hashnerf.hash_grid.compiled_or_eager", lambda fused, eager, wanted: fused)
    out = grid(places)
    fused = torch.autograd.grad(out, (grid.table, places), pull)
    monkeypatch.undo()
    assert torch.allclose(out, grid(places), atol=1e-6)
    for ours, expected in zip(fused, plain):
        assert torch.allclose(ours, expected, rtol=1e-4, atol=1e-5)


def test_positions_get_a_gradient_only_when_asked():
    grid = small_grid()
    grid(points(3)).sum().backward()
    assert grid.table.grad is not None
    places = points(3).requires_grad_()
    grid(places).sum().backward()
    assert places.grad.abs().sum() > 0


def test_no_points():
    grid = small_grid()
    out = grid(torch.zeros(0, 3))
    assert out.shape == (0, 6)
    out.sum().backward()
    assert (grid.table.grad == 0).all()


def test_batch_size_does_not_matter():
    grid, places = small_grid(), points(64)
    assert torch.allclose(torch.cat([grid(place[None]) for place in places]), grid(places), atol=1e-6)


def test_outlying_positions_leave_finite_gradients():
    finite_gradients(small_grid(), torch.cat([points(10), points(10) * 1e30]))


def test_the_initial_table_is_small_and_even():
    table = HashGrid(BOX, 4, 2, 14, 16, 128).table.detach()
    assert table.abs().max() <= 1e-4
    assert table.mean().abs() < 2e-6
    assert table.std().item() == pytest.approx(2e-4 / math.sqrt(12), rel=0.02)


@pytest.mark.parametrize("box", [[[0, 0, 0], [1, 0, 1]], [[0, 0, 0], [1, -1, 1]], [[0, 0, 0], [1, math.inf, 1]]])
def test_an_impossible_box_is_refused(box):
    with pytest.raises(UserError, match="side"):
        HashGrid(torch.tensor(box, dtype=torch.float32), 2, 2, 10, 4, 8)


@pytest.mark.parametrize(("finest", "flatness"), [(10**23, 1.0), (64, 1e30)])
def test_more_cells_along_a_side_than_32_bits_count_are_refused(finest, flatness):
    with pytest.raises(UserError, match=r"finest_resolution .* cells along a side"):
        HashGrid(torch.tensor([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]), 2, 2, 10, 4, finest, flatness=flatness)


@pytest.mark.parametrize("log2_table_size", [8, 20])
def test_flat_cells_equal_the_slow_reference(log2_table_size):
    grid = small_grid(dtype=torch.float64, log2_table_size=log2_table_size, flatness=3.0)
    # half a metre of height, in cells of a third of 0.25 m: 6 cells and 7 vertices
    assert grid.plan[-1].cell == 0.25 and grid.plan[-1].vertices == (17, 13, 7)
    where = points(20, torch.float64)
    expected = torch.tensor([slow_encode(grid, point) for point in where.tolist()], dtype=torch.float64)
    assert grid(where).detach() == pytest.approx(expected, abs=1e-6)


def test_flat_cells_have_the_right_slope():
    grid = small_grid(dtype=torch.float64, log2_table_size=20, flatness=3.0)
    assert torch.autograd.gradcheck(grid, points(6, torch.float64).requires_grad_(), eps=1e-7)
