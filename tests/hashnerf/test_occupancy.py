"""The occupancy grid: poison, spikes, emptiness, thin things, and the two numbers over a bank of conditions."""

import logging
import math

import pytest
import torch

from hashnerf.errors import UserError
from hashnerf.occupancy import MAX_THICKNESS, OccupancyConfig, OccupancyGrid

BOX = torch.tensor([[0.0, 0.0, 0.0], [4.0, 3.0, 1.0]])
ALL_AT_ONCE = OccupancyConfig(cell=1.0, warmup=1, turns=1)


def constant(*values):
    """A bank whose conditions have these densities everywhere."""
    return lambda positions: torch.tensor(values)[:, None].expand(-1, len(positions)).clone()


def in_cell(grid, cell, value):
    """One condition, dense in one cell."""

    def bank(positions):
        return torch.where(grid.cell_index(positions) == cell, value, 0.0)[None]

    return bank


def test_cells_fill_the_box_exactly():
    grid = OccupancyGrid(OccupancyConfig(cell=0.7), BOX)
    assert grid.shape == (6, 5, 2)  # 4/0.7 = 5.7, 3/0.7 = 4.3, 1/0.7 = 1.4
    assert grid.edge == pytest.approx(4 / 6)
    corners = torch.tensor([[0.0, 0.0, 0.0], [4.0, 3.0, 1.0], [-9.0, 99.0, 0.4]])
    assert grid.cell_index(corners).tolist() == [0, 59, 8]


def test_everything_is_occupied_during_the_warm_up():
    grid = OccupancyGrid(OccupancyConfig(cell=1.0, warmup=3), BOX)
    for _ in range(3):
        assert grid.occupied_fraction() == 1
        grid.update(in_cell(grid, 5, 10.0))
    assert grid.occupied().nonzero()[:, 0].tolist() == [5]


def test_maximum_and_minimum_over_the_bank():
    grid = OccupancyGrid(ALL_AT_ONCE, BOX)
    for _ in range(40):
        grid.update(constant(0.5, 3.0, 1.0))
    assert torch.allclose(grid.maximum, torch.full((12,), 3.0))
    assert torch.allclose(grid.minimum, torch.full((12,), 0.5))
    # in one condition the space is empty: nothing is opaque in every condition, from the next update on
    grid.update(constant(0.5, 0.0))
    assert (grid.minimum == 0).all()
    assert grid.occupied().all()


def test_the_usual_density_is_the_mean_of_the_emptiest_condition():
    grid = OccupancyGrid(ALL_AT_ONCE, BOX)
    low, high = grid.box
    half = lambda p: torch.where((p - low)[:, 0] / (high - low)[0] * grid.shape[0] % 1 < 0.5, 4.0, 0.0)  # noqa: E731
    seen = []
    for _ in range(60):
        grid.update(lambda p: torch.stack([half(p), torch.full((len(p),), 9.0)]))
        seen.append(grid.usual.clone())
    mean = torch.stack(seen[20:]).mean(dim=0)
    assert torch.allclose(mean, torch.full_like(mean, 2.0 * grid.edge), rtol=0.15)
    assert (grid.minimum < 2.0 * grid.edge).all()


def test_one_nan_does_not_poison_a_cell():
    grid = OccupancyGrid(ALL_AT_ONCE, BOX)
    grid.update(constant(1.0))
    for bad in (math.nan, math.inf):
        grid.update(in_cell(grid, 3, bad))
    assert grid.rejected == 2
    assert grid.maximum.isfinite().all()
    assert grid.maximum[3] == 1.0
    grid.update(constant(2.0))
    assert grid.maximum[3] == 2.0
    assert grid.rejected == 2


def test_an_empty_field_falls_back_to_every_cell_with_one_warning(caplog):
    grid = OccupancyGrid(ALL_AT_ONCE, BOX)
    with caplog.at_level(logging.WARNING):
        for _ in range(300):
            grid.update(constant(0.0))
            assert grid.occupied().all()
            assert (grid.densities()[0] > 0).all()
    assert len(caplog.records) == 1
    grid.update(in_cell(grid, 7, 5.0))
    assert grid.occupied().nonzero()[:, 0].tolist() == [7], "what becomes dense later is found by the next update"


def test_a_spike_is_forgotten_in_bounded_time():
    config = OccupancyConfig(cell=1.0, warmup=1, turns=1, decay=0.95)
    grid = OccupancyGrid(config, BOX)
    grid.update(in_cell(grid, 3, 3.27e6))
    assert grid.maximum[3] == MAX_THICKNESS
    # 10 * 0.95^n < 0.01 from n = 135 on
    for _ in range(134):
        grid.update(in_cell(grid, 5, 1.0))
    assert grid.occupied()[3]
    grid.update(in_cell(grid, 5, 1.0))
    assert not grid.occupied()[3]


def test_a_thin_pole_is_found_and_kept():
    # 100 columns of 8 cells; in each a pole an eighth of a cell wide at its own place
    config = OccupancyConfig(cell=1.0, points=4, warmup=1, turns=1)
    grid = OccupancyGrid(config, torch.tensor([[0.0, 0.0, 0.0], [10.0, 10.0, 8.0]]))
    low = torch.rand(10, 10, 2) * 0.875

    def poles(positions):
        column, place = positions[:, :2].long(), positions[:, :2] % 1
        start = low[column[:, 0], column[:, 1]]
        return torch.where(((place >= start) & (place < start + 0.125)).all(dim=1), 100.0, 0.0)[None]

    for _ in range(64):
        grid.update(poles)
    assert grid.occupied().float().mean() >= 0.99


def test_after_the_warm_up_cells_take_turns():
    config = OccupancyConfig(cell=0.5, warmup=1, turns=4, points=2)
    grid = OccupancyGrid(config, BOX)
    seen = torch.zeros(grid.maximum.numel(), dtype=torch.int64)

    def counting(positions):
        seen.index_add_(0, grid.cell_index(positions).long(), torch.ones(len(positions), dtype=torch.int64))
        return torch.ones(1, len(positions))

    grid.update(counting)
    assert (seen == 2).all()
    for _ in range(4):
        grid.update(counting)
    assert (seen == 4).all()
    assert grid.updates == 5


def test_points_of_a_cell_fill_it_evenly():
    grid = OccupancyGrid(OccupancyConfig(cell=1.0, warmup=1, turns=4), torch.tensor([[0.0] * 3, [1.0] * 3]))
    places = []

    def remember(positions):
        places.append(positions)
        return torch.ones(1, len(positions))

    for _ in range(129):
        grid.update(remember)
    seen = torch.cat(places)
    assert ((seen > 0) & (seen < 1)).all()
    octants = (seen * 2).long() @ torch.tensor([4, 2, 1])
    counts = torch.bincount(octants, minlength=8)
    assert counts.min() >= 0.75 * counts.float().mean()


def test_state_is_saved_and_restored():
    grid, other = OccupancyGrid(ALL_AT_ONCE, BOX), OccupancyGrid(ALL_AT_ONCE, BOX)
    grid.update(in_cell(grid, 3, 2.0))
    other.load_state_dict(grid.state_dict())
    for ours, theirs in zip(grid.densities(), other.densities()):
        assert torch.equal(ours, theirs)
    assert other.updates == 1


@pytest.mark.parametrize(
    ("key", "value"),
    [("cell", 0.0), ("threshold", math.inf), ("decay", 1.0), ("points", 0), ("warmup", 0), ("turns", 0)],
)
def test_impossible_configs_name_the_key(key, value):
    with pytest.raises(UserError, match=f"occupancy.{key} is"):
        OccupancyConfig(**{key: value})
