"""A trained field's density, stored: where samples belong along a ray is then a look-up instead of a network's answer.

Every occupied cell of the occupancy grid is cut into equal parts, and the density at the middle of each is kept as a
half-precision number (its largest, 65,504 per metre, is opaque over any part). Cells that are not occupied are empty.
"""

import math
from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from hashnerf.errors import UserError
from hashnerf.occupancy import OccupancyGrid

AT_ONCE = 1 << 16  # densities asked for together


class BakedDensity:
    """Density (1/m) by position; it does not follow the field when that is trained on."""

    @torch.no_grad()
    def __init__(
        self,
        occupancy: OccupancyGrid,
        parts: tuple[int, int, int],
        density_fn: Callable[[Float[Tensor, "p 3"]], Float[Tensor, " p"]],
    ):
        """Cuts occupied cells into `parts` along x, y and z; raises UserError for parts that are no positive numbers.

        `density_fn` is asked once for the middle of every part; what it cannot tell (NaN) counts as empty.
        """
        if min(parts) < 1:
            raise UserError(f"parts of a cell are {parts}: use at least 1 along every axis")
        self.occupancy, self.parts = occupancy, parts
        device = occupancy.maximum.device
        cells = occupancy.occupied().nonzero()[:, 0]
        self.row = torch.full((occupancy.maximum.numel(),), len(cells), dtype=torch.int32, device=device)
        self.row[cells] = torch.arange(len(cells), dtype=torch.int32, device=device)
        steps = [(torch.arange(count, device=device) + 0.5) / count for count in parts]
        inside = torch.stack(torch.meshgrid(*steps, indexing="ij"), dim=-1).view(-1, 3)
        # the last row, of zeros, answers for every cell that is not occupied
        self.density = torch.zeros(len(cells) + 1, math.prod(parts), dtype=torch.float16, device=device)
        greatest = torch.finfo(torch.float16).max
        for rows in torch.arange(len(cells), device=device).split(max(AT_ONCE // math.prod(parts), 1)):
            places = (occupancy.lattice_of(cells[rows])[:, None] + inside) / occupancy.inverse_edges
            found = density_fn(occupancy.box[0] + places.view(-1, 3)).clamp(0, greatest)
            self.density[rows] = torch.where(found.isnan(), 0.0, found).view(len(rows), -1).half()

    def __call__(self, positions: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """Returns the density at positions (m); outside the box that of the nearest part, as the grid has it."""
        place = (positions - self.occupancy.box[0]) * self.occupancy.inverse_edges
        cell = part = torch.zeros(len(place), dtype=torch.int32, device=place.device)
        for along, cells, parts in zip(place.unbind(dim=1), self.occupancy.shape, self.parts):
            number = (along * parts).clamp(0, cells * parts - 1).to(torch.int32)
            cell = cell * cells + number // parts
            part = part * parts + number % parts
        return self.density[self.row[cell], part].float()
