"""The hash grid's numbered rows: overflow, faces and corners, bad positions, weights, gradients of crowded cells."""

import itertools
import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from hashnerf.errors import UserError
from hashnerf.hash_grid import HashGrid, plan_levels, spatial_hash

HALVES = (torch.float16, torch.bfloat16)
AXES = (0, 1, 2)


def cube(side: float, levels: int, log2_table_size: int, base: int, finest: int, features: int = 2) -> HashGrid:
    """A grid over [0, side]^3 with a table between -1 and 1."""
    grid = HashGrid(torch.tensor([[0.0] * 3, [side] * 3]), levels, features, log2_table_size, base, finest)
    torch.nn.init.uniform_(grid.table, -1, 1)
    return grid


def entry_read_at(vertex: tuple[int, int, int], resolution: int, log2_table_size: int) -> int:
    """The table entry that the grid reads at a vertex of a lattice: every entry holds its own number."""
    grid = cube(float(resolution), 1, log2_table_size, resolution, resolution)
    grid.table.data = torch.arange(grid.plan[0].entries).float().repeat_interleave(2)
    return int(grid(torch.tensor([vertex], dtype=torch.float32))[0, 0])


def unsigned_hash(vertex: tuple[int, int, int], table_size: int) -> int:
    """The hash in Python's unbounded integers."""
    x, y, z = vertex
    return ((x ^ (y * 2654435761) ^ (z * 805459861)) & 0xFFFFFFFF) % table_size


def linear_in_x(side: float, resolution: int, slopes: tuple[float, float]) -> HashGrid:
    """A dense grid over [0, side]^3 whose two features rise along x alone."""
    grid = cube(side, 1, 24, resolution, resolution)
    x = torch.arange(resolution + 1) * (side / resolution)
    column = x.repeat((resolution + 1) ** 2)  # x runs fastest
    grid.table.data = torch.stack([column * slope for slope in slopes], dim=1).flatten()
    return grid


def slope_at(grid: HashGrid, place: Tensor, axis: int) -> Tensor:
    """Slope of both features along an axis."""
    place = place.clone().requires_grad_()
    out = grid(place)[0]
    return torch.stack([torch.autograd.grad(value, place, retain_graph=True)[0][0, axis] for value in out])


GOLDEN = {
    ((1, 1, 1), 19): 339493,
    ((1, 2, 3), 19): 128476,
    ((2047, 2047, 2047), 19): 285147,
    ((524287, 524287, 524287), 19): 184795,
    ((-1, -1, -1), 19): 184795,
    ((2**31 - 1, 0, 1), 19): 370794,
    ((1, 2, 3), 14): 13788,
}


def test_n01_the_hash_equals_the_unsigned_product(numeric_row):
    types = (torch.int32, torch.int64)
    read = [
        spatial_hash(torch.tensor([vertex], dtype=dtype), 1 << log2).item() != expected
        for (vertex, log2), expected in GOLDEN.items()
        for dtype in types
    ]
    numeric_row("N01", f"{len(GOLDEN)} vertices as int32 and int64", sum(read))
    # a position reaches a vertex exactly up to 2^24; the coordinates are the lattice's own, so never negative
    inside = {key: value for key, value in GOLDEN.items() if min(key[0]) >= 0 and max(key[0]) < 1 << 20}
    read = [entry_read_at(vertex, 1 << 20, log2) != expected for (vertex, log2), expected in inside.items()]
    numeric_row("N01", f"the grid's own look-up at {len(inside)} vertices", sum(read))


@given(st.lists(st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 3), min_size=1, max_size=50), st.integers(0, 28))
def test_the_hash_stays_inside_the_table(vertices, log2):
    index = spatial_hash(torch.tensor(vertices), 1 << log2)
    assert index.tolist() == [unsigned_hash(vertex, 1 << log2) for vertex in vertices]
    assert index.min() >= 0
    assert index.max() < 1 << log2


def test_n02_a_table_that_is_no_power_of_two_is_refused(numeric_row):
    accepted = 0
    for size in (500009, 3, (1 << 19) - 1, 0, -4):
        for vertex in ((1, 2, 3), (1, 1, 1)):
            try:
                spatial_hash(torch.tensor([vertex]), size)
                accepted += 1
            except ValueError as error:
                assert str(size) in str(error)
    numeric_row("N02", "tables of 500009, 3, 2^19-1, 0, -4 entries", accepted)


def test_n03_negative_coordinates_stay_inside_the_table(numeric_row):
    negative = torch.randint(-(2**31), 0, (100_000, 3))
    places = torch.cat([torch.tensor([[-1, 0, 0], [-1, -1, -1], [-(2**31)] * 3]), negative])
    outside = 0
    for size in (1, 1 << 14, 1 << 19, 1 << 28):
        index = spatial_hash(places, size)
        outside += int(((index < 0) | (index >= size)).sum())
    numeric_row("N03", "(-1,0,0), (-1,-1,-1), 1e5 negative vertices", outside)


def test_n04_dense_only_where_every_vertex_has_an_entry(numeric_row):
    wrong = 0
    for resolution in (16, 32, 79, 80, 1290, 1291, 1625, 1626, 2048, 65536):
        vertices = resolution + 1
        (level,) = plan_levels((1.0, 1.0, 1.0), 1, 2, 19, resolution, resolution)
        assert level.vertices == (vertices,) * 3
        # 80^3 = 512,000 < 2^19 < 81^3 vertices
        assert level.hashed == (resolution > 79)
        assert level.entries == (1 << 19 if level.hashed else vertices**3)
        last = unsigned_hash((resolution,) * 3, 1 << 19) if level.hashed else vertices**3 - 1
        wrong += entry_read_at((resolution,) * 3, resolution, 19) != last
    numeric_row("N04", "last vertex of 16 to 65536 cells a side, 2^19 entries", wrong)


def test_n05_offsets_beyond_32_bits(numeric_row):
    with torch.device("meta"):  # nothing is allocated
        grid = HashGrid(torch.tensor([[0.0] * 3, [1.0] * 3], device="cpu"), 16, 8, 24, 2048, 4096)
    wrong = sum(level.offset != number * 2**24 * 8 for number, level in enumerate(grid.plan))
    numeric_row("N05", "16 levels x 2^24 entries x 8 features", wrong + (grid.table.numel() != 2**31))
    with torch.device("meta"), pytest.raises(UserError, match="features_per_level"):
        HashGrid(torch.tensor([[0.0] * 3, [1.0] * 3], device="cpu"), 1, 16, 28, 2048, 4096)


def test_n06_cell_faces_have_the_slope_of_one_side(numeric_row):
    apart = off = 0.0
    for resolution in (8, 100):
        rising = linear_in_x(1.0, resolution, (3.0, 5.0))
        for cells in (0, 1, resolution // 2, resolution - 1, resolution):
            face = torch.tensor(cells / resolution, dtype=torch.float32).item()
            at_face = rising(torch.tensor([[face, 0.3, 0.6]]))
            for toward in (face, -1.0, 2.0):
                value = torch.nextafter(torch.tensor(face), torch.tensor(toward)).clamp(0, 1)
                place = torch.tensor([[value, 0.3, 0.6]])
                excess = (rising(place) - at_face).abs() - 2 * torch.tensor([3.0, 5.0]) * (value - face).abs()
                apart = max(apart, excess.max().item())
                slope = slope_at(rising, place, 0)
                assert (slope != 0).all()
                off = max(off, ((slope - torch.tensor([3.0, 5.0])).abs() / torch.tensor([3.0, 5.0])).max().item())
    numeric_row("N06", "jump beyond twice slope times step at faces +- 1 step, slopes 3 and 5", apart, 1e-6)
    numeric_row("N06", "relative error of the slope at faces +- 1 step", off, 1e-4)


@pytest.mark.parametrize("axis", AXES)
def test_n06_faces_of_an_uneven_table_take_either_side(axis, numeric_row):
    grid = cube(1.0, 1, 12, 8, 8)
    exact, step, worst = cube(1.0, 1, 12, 8, 8).double(), 2.0**-10, 0.0
    exact.table.data = grid.table.data.double()
    for cells in (0, 1, 4, 7, 8):
        place = torch.full((1, 3), 0.3)
        place[0, axis] = cells / 8
        slope, sides = slope_at(grid, place, axis).double(), []
        for way in (1, -1):
            there = place.double()
            there[0, axis] += way * step
            if 0 <= there[0, axis] <= 1:  # along an axis the interpolation is linear, so this difference is exact
                sides.append(((exact(there) - exact(place.double()))[0] * way / step - slope).abs().max().item())
        worst = max(worst, min(sides))
    numeric_row("N06", f"slope against one side's difference, table from -1 to 1, axis {axis}", worst, 1e-4)


def test_n07_the_upper_face_belongs_to_the_box(numeric_row):
    worst, misplaced = 0.0, 0
    for resolution in (8, 49, 100):
        grid = cube(1.0, 1, 24, resolution, resolution)
        rows = grid.rows(grid.table, grid.plan[0]).view(*[resolution + 1] * 3, 2)  # z, y, x
        for corner in itertools.product((0, 1), repeat=3):
            stored = rows[tuple(resolution * bit for bit in reversed(corner))]
            worst = max(worst, (grid(torch.tensor([corner]).float())[0] - stored).abs().max().item())
        for axis, value in itertools.product(AXES, (0.0, -0.0, 1.0, 1 - 2**-24)):
            place = torch.full((1, 3), 0.5)
            place[0, axis] = value
            near = place.clone()
            near[0, axis] = round(value)
            # a table from -1 to 1 rises by at most 2 a cell
            misplaced += bool(((grid(place) - grid(near)).abs() > 2 * 2 * resolution * 2**-24).any())
            misplaced += bool((grid(place) == 0).any())
            beyond = torch.nextafter(torch.tensor(1.0), torch.tensor(2.0)) if value else torch.tensor(-1e-45)
            place[0, axis] = beyond
            misplaced += bool((grid(place) != 0).any())
    numeric_row("N07", "eight corners against the stored vertices", worst, 1e-6)
    numeric_row("N07", "0, -0.0, 1, 1-2^-24 inside and the next numbers outside", misplaced)


BAD_COORDINATES = (-1e-7, -0.3, 1.0000001, 1.3, 1e4, 1e30, math.inf, -math.inf, math.nan)


def test_n08_outside_the_box_is_zero_without_gradient(numeric_row):
    grid, good, wrong = cube(1.0, 2, 12, 8, 100), torch.rand(4, 3), 0
    others = [0, 1, 3]
    alone = grid(good)[others]
    for bad, axis in itertools.product(BAD_COORDINATES, AXES):
        place = good.clone()
        place[2, axis] = bad
        place.requires_grad_()
        grid.table.grad = None
        out = grid(place)
        out.sum().backward()
        holds = (
            bool((out[2] == 0).all())
            and torch.equal(out[others], alone)
            and bool((place.grad[2] == 0).all())
            and bool(place.grad.isfinite().all())
            and bool((place.grad[others] != 0).any(dim=1).all())
            and bool(grid.table.grad.isfinite().all())
        )
        wrong += not holds
    numeric_row("N08", "-1e-7 to 1e30, infinities and NaN on each axis, among good rows", wrong)


def test_n08_nan_raises_in_anomaly_mode(numeric_row):
    grid = cube(1.0, 3, 8, 4, 16)
    with torch.autograd.detect_anomaly(check_nan=False), pytest.raises(ValueError, match="NaN"):
        grid(torch.full((1, 3), math.nan))
    numeric_row("N08", "NaN while autograd looks for anomalies: ValueError", 0)


def test_n09_half_positions_are_upcast_even_under_autocast(numeric_row):
    grid = cube(1.0, 2, 14, 16, 2048)
    worst, places = 0.0, torch.cat([torch.full((1, 3), 0.7), torch.rand(64, 3)])
    for dtype in (*HALVES, torch.float32):
        place = places.to(dtype)
        plain = grid(place.float())
        with torch.autocast("cpu", dtype=torch.bfloat16):
            inside = grid(place)
        assert inside.dtype == torch.float32
        worst = max(worst, (inside - plain).abs().max().item())
    numeric_row("N09", "0.7 and 64 places in 2048 cells, three formats under autocast", worst)


@pytest.mark.parametrize("form", ["one library call", "the compiler's form"])
def test_n11_weights_are_a_partition_of_unity(form, numeric_row, monkeypatch):
    if form == "the compiler's form":  # run without the compiler: the arithmetic is the same
        monkeypatch.setattr("hashnerf.hash_grid.compiled_or_eager", lambda fused, eager, wanted: fused)
    grid, places = cube(1.0, 3, 8, 4, 100), torch.rand(100_000, 3)
    worst = {1.0: 0.0, 0.7: 0.0}
    for dtype, stored in itertools.product((torch.float32, *HALVES), worst):
        grid.table.data.fill_(stored)
        with torch.autocast("cpu", dtype=torch.bfloat16):
            out = grid(places.to(dtype))
        worst[stored] = max(worst[stored], (out - torch.tensor(stored)).abs().max().item())
    numeric_row("N11", f"sum of weights at 1e5 places in three formats, {form}", worst[1.0], 4e-7)
    numeric_row("N11", f"a table of 0.7 at 1e5 places in three formats, {form}", worst[0.7], 1e-6)


def test_n11_a_linear_table_is_reproduced(numeric_row):
    grid, x = cube(8.0, 1, 12, 8, 8), torch.arange(9.0)
    z, y, x = torch.meshgrid(x, x, x, indexing="ij")
    grid.table.data = torch.stack([x + 2 * y - z, 4 - y], dim=-1).flatten()
    worst = 0.0
    for dtype in (torch.float32, *HALVES):
        place = (torch.rand(1000, 3) * 8).to(dtype)
        x, y, z = place.double().unbind(dim=1)
        truth = torch.stack([x + 2 * y - z, 4 - y], dim=1)
        worst = max(worst, (grid(place) - truth).abs().max().item())
    numeric_row("N11", "tables of x+2y-z and 4-y up to 24, places in three formats", worst, 1e-5)


@pytest.mark.parametrize("features", [2, 4])
def test_n11_gradients_against_finite_differences(features, numeric_row):
    grid = HashGrid(torch.tensor([[-2.0, 1.0, 0.0], [2.0, 4.0, 0.5]]), 2, features, 4, 2, 8).double()
    low, high = grid.box
    places = (low + torch.rand(4, 3, dtype=torch.float64) * (high - low)).requires_grad_()
    table = torch.rand(grid.table.shape, dtype=torch.float64, requires_grad=True)

    def encode(table, positions):
        return torch.func.functional_call(grid, {"table": table}, (positions,))

    agrees = torch.autograd.gradcheck(encode, (table, places))
    numeric_row("N11", f"gradients of table and places in float64, {features} features", float(not agrees))


def test_n12_a_million_points_in_one_cell(numeric_row):
    grid = cube(8.0, 1, 12, 8, 8)
    place, pull = torch.rand(1_000_000, 3) * 0.5 + 2.25, torch.full((1_000_000, 2), 1e-4)
    passes = []
    torch.use_deterministic_algorithms(True)
    try:
        for _ in range(2):
            grid.table.grad = None
            grid(place).backward(pull)
            passes.append(grid.table.grad.clone())
    finally:
        torch.use_deterministic_algorithms(False)
    # the eight weights of a point sum to 1: the table receives 1e6 * 1e-4 = 100 a feature
    total = passes[0].view(-1, 2).double().sum(dim=0)
    numeric_row("N12", "1e6 points in one cell, 1e-4 each: sum against 100", (total - 100).abs().max().item(), 1e-3)
    numeric_row("N12", "numbers that differ in a second pass", int((passes[0] != passes[1]).sum()))
