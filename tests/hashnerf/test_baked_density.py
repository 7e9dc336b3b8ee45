"""Stored densities: what is looked up is what the field said there."""

import pytest
import torch

from hashnerf.baked_density import BakedDensity
from hashnerf.errors import UserError
from hashnerf.occupancy import OccupancyConfig, OccupancyGrid

BOX = torch.tensor([[-1.0, 0.0, 0.0], [1.0, 1.0, 0.5]])


def grid(density_fn=None) -> OccupancyGrid:
    occupancy = OccupancyGrid(OccupancyConfig(cell=0.25, threshold=0.01), BOX)
    for _ in range(8):
        occupancy.update(lambda p: (density_fn or slope)(p)[None])
    return occupancy


def slope(positions: torch.Tensor) -> torch.Tensor:
    """Grows with every coordinate at another rate, so that no two parts are alike."""
    return 100 + positions @ torch.tensor([7.0, 50.0, 300.0])


def test_middles_of_parts_are_exact_and_other_places_get_their_part():
    baked = BakedDensity(grid(), (2, 3, 5), slope)
    edges = 0.25 / torch.tensor([2.0, 3.0, 5.0])
    positions = BOX[0] + torch.rand(500, 3, generator=torch.Generator().manual_seed(0)) * (BOX[1] - BOX[0])
    middles = BOX[0] + (((positions - BOX[0]) / edges).floor() + 0.5) * edges
    torch.testing.assert_close(baked(positions), slope(middles), rtol=1e-3, atol=0)


def test_cells_that_are_not_occupied_are_empty_and_never_asked_for():
    def half(positions: torch.Tensor) -> torch.Tensor:
        return torch.where(positions[:, 0] > 0, 80.0, 0.0)

    asked = []

    def watched(positions: torch.Tensor) -> torch.Tensor:
        asked.append(positions)
        return half(positions)

    baked = BakedDensity(grid(half), (2, 2, 2), watched)
    assert float(torch.cat(asked)[:, 0].min()) > 0
    positions = torch.tensor([[-0.5, 0.5, 0.2], [0.5, 0.5, 0.2]])
    assert baked(positions).tolist() == [0.0, 80.0]


def test_faces_and_what_lies_outside_belong_to_the_nearest_part():
    baked = BakedDensity(grid(), (2, 2, 2), slope)
    outside = torch.tensor([[3.0, 2.0, 9.0], [1.0, 1.0, 0.5], [-9.0, -1.0, -1.0]])
    nearest = torch.tensor([[0.9375, 0.9375, 0.4375], [0.9375, 0.9375, 0.4375], [-0.9375, 0.0625, 0.0625]])
    torch.testing.assert_close(baked(outside), slope(nearest), rtol=1e-3, atol=0)


def test_extreme_densities_stay_finite():
    occupancy = grid()

    def extreme(positions: torch.Tensor) -> torch.Tensor:
        values = torch.tensor([1e30, torch.inf, torch.nan, -5.0])
        return values[torch.arange(len(positions)) % 4]

    baked = BakedDensity(occupancy, (4, 1, 1), extreme)
    middles = BOX[0] + (torch.tensor([[0.0, 0.0, 0.0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]) + 0.5) * torch.tensor(
        [0.0625, 0.25, 0.25]
    )
    assert baked(middles).tolist() == [65504.0, 65504.0, 0.0, 0.0]


def test_no_positions_no_densities():
    assert BakedDensity(grid(), (1, 1, 1), slope)(torch.zeros(0, 3)).shape == (0,)


def test_parts_must_be_positive():
    with pytest.raises(UserError, match="at least 1"):
        BakedDensity(grid(), (2, 0, 2), slope)
