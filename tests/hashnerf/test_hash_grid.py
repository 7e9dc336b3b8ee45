"""The hash grid against goldens, a slow reference, the faces of the box and bad positions."""

import itertools
import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hashnerf.errors import UserError
from hashnerf.hash_grid import HashGrid, plan_levels, spatial_hash
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


@pytest.mark.parametrize(
    ("vertex", "expected"),
    [
        ((1, 1, 1), 339493),
        ((1, 2, 3), 128476),
        ((2047, 2047, 2047), 285147),
        ((524287, 524287, 524287), 184795),
        ((-1, -1, -1), 184795),
        ((2**31 - 1, 0, 1), 370794),
    ],
)
def test_hash_equals_the_unsigned_product(vertex, expected):
    assert spatial_hash(torch.tensor([vertex]), 1 << 19).item() == expected


def test_hash_in_a_smaller_table():
    assert spatial_hash(torch.tensor([[1, 2, 3]]), 1 << 14).item() == 13788


def test_hash_refuses_a_table_that_is_no_power_of_two():
    with pytest.raises(ValueError, match="500009"):
        spatial_hash(torch.tensor([[1, 2, 3]]), 500009)


@given(st.lists(st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 3), min_size=1, max_size=50), st.integers(0, 28))
def test_hash_stays_inside_the_table(vertices, log2):
    index = spatial_hash(torch.tensor(vertices), 1 << log2)
    assert index.min() >= 0
    assert index.max() < 1 << log2


def test_dense_only_where_every_vertex_has_an_entry():
    for resolution in (16, 32, 1290, 1291, 1625, 1626, 2048, 65536):
        (level,) = plan_levels((1.0, 1.0, 1.0), 1, 2, 19, resolution, resolution)
        assert level.vertices == (resolution + 1,) * 3
        # 80^3 = 512,000 < 2^19 < 81^3 vertices
        assert level.hashed == (resolution + 1 > 80)
        assert level.entries == (1 << 19 if level.hashed else (resolution + 1) ** 3)


def test_cells_are_cubes_in_a_flat_box():
    levels = plan_levels((80.0, 60.0, 10.0), 3, 2, 17, 16, 64)
    # resolutions 16, 32, 64 along 80 m: cells of 5, 2.5 and 1.25 m
    assert [level.cell for level in levels] == [5.0, 2.5, 1.25]
    assert levels[0].vertices == (17, 13, 3)
    assert levels[2].vertices == (65, 49, 9)


def test_the_last_vertex_of_a_fine_lattice_is_reachable():
    grid = HashGrid(torch.tensor([[0.0] * 3, [1.0] * 3]), 2, 2, 10, 2048, 65536)
    corner = torch.tensor([[1.0, 1.0, 1.0]])
    row = spatial_hash(torch.tensor([[65536, 65536, 65536]]), 1 << 10)
    assert torch.allclose(grid(corner)[0, 2:], grid.rows(grid.table, grid.plan[1])[row[0]], atol=1e-9)


def test_offsets_beyond_32_bits():
    with torch.device("meta"):
        grid = HashGrid(BOX, 16, 8, 24, 2048, 4096)
    assert grid.plan[-1].offset == 15 * 2**24 * 8
    assert grid.table.numel() == 2**31


@pytest.mark.parametrize("features", [2, 4])
def test_against_the_slow_reference(features):
    grid = small_grid(features)
    assert {level.hashed for level in grid.plan} == {True, False}
    places = points(40)
    truth = torch.tensor([slow_encode(grid, place) for place in places.tolist()])
    assert torch.allclose(grid(places), truth, atol=2e-5)


@pytest.mark.parametrize("features", [2, 4])
def test_gradients_against_finite_differences(features):
    grid = HashGrid(BOX, 2, features, 4, 2, 8).double()
    places = points(4, torch.float64).requires_grad_()
    table = torch.rand(grid.table.shape, dtype=torch.float64, requires_grad=True)

    def encode(table, positions):
        return torch.func.functional_call(grid, {"table": table}, (positions,))

    assert torch.autograd.gradcheck(encode, (table, places))


def test_positions_get_a_gradient_only_when_asked():
    grid = small_grid()
    grid(points(3)).sum().backward()
    assert grid.table.grad is not None
    places = points(3).requires_grad_()
    grid(places).sum().backward()
    assert places.grad.abs().sum() > 0


def test_cell_faces_have_the_slope_of_one_side():
    grid = HashGrid(torch.tensor([[0.0] * 3, [8.0] * 3]), 1, 2, 12, 8, 8)
    x = torch.arange(9.0)
    rows = torch.stack(torch.meshgrid(x, x, x, indexing="ij")).permute(3, 2, 1, 0).reshape(-1, 3)
    # a table linear in x with slopes 3 and 5; dense order has x fastest
    grid.table.data = torch.stack([3 * rows[:, 0], 5 * rows[:, 0]], dim=1).flatten()
    for face in (0.0, 1.0, 4.0, 7.0, 8.0):
        for value in (face, math.nextafter(face, -1), math.nextafter(face, 9)):
            place = torch.tensor([[value, 2.5, 2.5]]).clamp(0, 8).requires_grad_()
            out = grid(place)
            assert torch.allclose(out[0], torch.tensor([3.0, 5.0]) * place[0, 0].detach(), atol=1e-5)
            (gradient,) = torch.autograd.grad(out.sum(), place)
            assert gradient[0, 0].item() == pytest.approx(8.0, abs=1e-4)
            assert gradient[0, 1:].abs().max() < 1e-4


def test_corners_of_the_box_equal_their_vertices():
    grid = HashGrid(torch.tensor([[0.0] * 3, [1.0] * 3]), 1, 2, 12, 8, 8)
    for corner in itertools.product((0, 1), repeat=3):
        row = sum(8 * bit * 9**axis for axis, bit in enumerate(corner))
        stored = grid.rows(grid.table, grid.plan[0])[row]
        assert torch.allclose(grid(torch.tensor([corner], dtype=torch.float32))[0], stored, atol=1e-9)


@pytest.mark.parametrize("value", [0.0, -0.0, 1.0, 1 - 2**-24])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_faces_are_inside(value, axis):
    grid = HashGrid(torch.tensor([[0.0] * 3, [1.0] * 3]), 2, 2, 12, 8, 100)
    place = torch.full((1, 3), 0.5)
    place[0, axis] = value
    assert grid(place).abs().min() > 0


@pytest.mark.parametrize("bad", [-1e-7, -0.3, 1.0000001, 1.3, 1e4, 1e30, math.inf, -math.inf, math.nan])
def test_outside_the_box_is_zero_without_gradient(bad):
    grid = HashGrid(torch.tensor([[0.0] * 3, [1.0] * 3]), 2, 2, 12, 8, 100)
    good = torch.rand(4, 3)
    place = good.clone()
    place[2, 1] = bad
    place.requires_grad_()
    out = grid(place)
    assert (out[2] == 0).all()
    assert torch.equal(out[[0, 1, 3]], grid(good)[[0, 1, 3]]), "a bad row changed the others"
    out.sum().backward()
    assert (place.grad[2] == 0).all()
    assert place.grad.isfinite().all()
    assert grid.table.grad.isfinite().all()


def test_nan_raises_in_anomaly_mode():
    grid = small_grid()
    with torch.autograd.detect_anomaly(check_nan=False), pytest.raises(ValueError, match="NaN"):
        grid(torch.full((1, 3), math.nan))


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_positions_are_upcast_even_under_autocast(dtype):
    grid = HashGrid(torch.tensor([[0.0] * 3, [1.0] * 3]), 2, 2, 14, 16, 2048)
    place = torch.full((1, 3), 0.7, dtype=dtype)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        inside = grid(place)
    assert inside.dtype == torch.float32
    assert torch.equal(inside, grid(place.float()))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_weights_are_a_partition_of_unity(dtype):
    grid = small_grid(dtype=dtype)
    grid.table.data.fill_(0.7)
    out = grid(points(100_000, dtype))
    assert (out - 0.7).abs().max() <= 1e-6


def test_a_linear_table_is_reproduced():
    grid = HashGrid(torch.tensor([[0.0] * 3, [8.0] * 3]), 1, 2, 12, 8, 8)
    x = torch.arange(9.0)
    z, y, x = torch.meshgrid(x, x, x, indexing="ij")
    grid.table.data = torch.stack([x + 2 * y - z, 4 - y], dim=-1).flatten()
    place = torch.rand(1000, 3) * 8
    truth = torch.stack([place[:, 0] + 2 * place[:, 1] - place[:, 2], 4 - place[:, 1]], dim=1)
    assert (grid(place) - truth).abs().max() < 1e-5


def test_a_million_points_in_one_cell():
    grid = HashGrid(torch.tensor([[0.0] * 3, [8.0] * 3]), 1, 2, 12, 8, 8)
    place = torch.rand(1_000_000, 3) * 0.5 + 2.25
    grid(place).backward(torch.full((1_000_000, 2), 1e-4))
    # the eight weights of a point sum to 1: the table receives 1e6 * 1e-4 = 100 a feature
    total = grid.table.grad.view(-1, 2).sum(dim=0)
    assert (total - 100).abs().max() < 0.1
    first = grid.table.grad.clone()
    grid.table.grad = None
    grid(place).backward(torch.full((1_000_000, 2), 1e-4))
    assert torch.equal(first, grid.table.grad)


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
