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


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_n40_a_broken_density_does_not_poison_a_cell(bad, caplog, numeric_row):
    grid = OccupancyGrid(ALL_AT_ONCE, BOX)
    grid.update(constant(1.0))
    before = [values.clone() for values in (grid.maximum, grid.minimum, grid.usual)]
    grid.update(in_cell(grid, 3, bad))
    wrong = int(grid.rejected != 1) + (len(caplog.records) != 1)
    for old, new in zip(before, (grid.maximum, grid.minimum, grid.usual)):
        wrong += int((~new.isfinite()).sum()) + int(new[3] != old[3])
    grid.update(constant(2.0))
    wrong += int((grid.maximum != 2.0).sum()) + int(grid.rejected != 1) + int((~grid.occupied()).sum())
    wrong += len(caplog.records) != 1  # one warning
    numeric_row("N40", f"{bad} in one cell, then a clean update", wrong)


@pytest.mark.parametrize("turns", [1, 4])
@pytest.mark.parametrize("emptied", [0.0, -1.0, "300 updates"])
def test_n41_an_empty_grid_skips_everything_with_one_warning_and_fills_again(emptied, turns, caplog, numeric_row):
    grid, wrong = OccupancyGrid(OccupancyConfig(cell=1.0, warmup=1, turns=turns), BOX), 0
    with caplog.at_level(logging.WARNING):
        for _ in range(300 if isinstance(emptied, str) else 1):
            grid.update(constant(0.0))
            if not isinstance(emptied, str):
                grid.maximum.fill_(emptied)  # as if no cell had been seen by any camera
            wrong += int(grid.occupied().sum()) + int((grid.densities()[0] != 0).sum()) + (not grid.is_empty())
    wrong += len(caplog.records) != 1
    for _ in range(turns):
        grid.update(in_cell(grid, 7, 5.0))
    # what becomes dense later is found by the next turn through all cells
    wrong += grid.occupied().nonzero()[:, 0].tolist() != [7]
    numeric_row("N41", f"nothing occupied ({emptied}), then one dense cell, {turns} turns", wrong)


def test_a_grid_that_saw_no_number_is_not_empty():
    grid = OccupancyGrid(ALL_AT_ONCE, BOX)
    grid.update(constant(math.nan))
    assert grid.occupied().all(), "a field that is NaN everywhere must reach the loss, which reports it"


def test_the_unseen_grid_is_sampled_everywhere():
    grid = OccupancyGrid(ALL_AT_ONCE, BOX)
    grid.update(constant(0.0))
    assert grid.is_empty()
    assert grid.unseen().occupied().all() and grid.unseen().shape == grid.shape


@pytest.mark.parametrize("spike", [3.27e6, 3e38])
def test_n42_a_spike_is_forgotten_in_bounded_time(spike, numeric_row):
    grid, updates = OccupancyGrid(OccupancyConfig(cell=1.0, warmup=1, turns=1), BOX), 0
    grid.update(in_cell(grid, 3, spike))
    assert grid.maximum[3] == MAX_THICKNESS
    while grid.occupied()[3] and updates < 1000:
        grid.update(in_cell(grid, 5, 1.0))
        updates += 1
    # 10 * 0.95^n < 0.01 from n = 135 on
    assert updates > 100, "what is opaque must not be forgotten at once"
    numeric_row("N42", f"updates until a density of {spike:.3g} is forgotten", updates, 135)


def test_n43_thin_poles_are_found_and_kept(numeric_row):
    # a slice of a grid of 128^3 cells: 100 of its columns hold a pole an eighth of a cell wide, each at its own place
    config = OccupancyConfig(cell=1.0, points=4, warmup=1, turns=1)
    grid = OccupancyGrid(config, torch.tensor([[0.0, 0.0, 0.0], [128.0, 128.0, 2.0]]))
    columns = torch.randperm(128 * 128)[:100]
    low = torch.full((128 * 128, 2), 9.0)
    low[columns] = torch.rand(100, 2) * 0.875

    def poles(positions):
        column, place = positions[:, 0].long() * 128 + positions[:, 1].long(), positions[:, :2] % 1
        start = low[column]
        return torch.where(((place >= start) & (place < start + 0.125)).all(dim=1), 100.0, 0.0)[None]

    for _ in range(64):
        grid.update(poles)
    occupied = grid.occupied().view(128 * 128, 2)
    numeric_row(
        "N43",
        "100 poles, 64 updates of 4 points: share of their cells missed",
        1 - occupied[columns].float().mean(),
        0.01,
    )
    assert occupied.sum() == occupied[columns].sum(), "and nothing else is occupied"


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
    [
        ("cell", -1.0),
        ("threshold", math.inf),
        ("decay", 1.0),
        ("points", 0),
        ("points", 131073),
        ("warmup", 0),
        ("turns", 0),
    ],
)
def test_impossible_configs_name_the_key(key, value):
    with pytest.raises(UserError, match=f"occupancy.{key} is"):
        OccupancyConfig(**{key: value})
