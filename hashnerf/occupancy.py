"""Which parts of the scene box are worth sampling, in any of the states a field can be conditioned on.

Notation: thickness = density * cell edge, the optical thickness of crossing a cell, bounded by `MAX_THICKNESS`. Three
numbers a cell: `maximum` over a bank of conditions (a cell that is empty in every condition is skipped), `minimum` over
the bank (a ray ends behind cells that are opaque in every condition) and `usual`, the mean over the cell in the
emptiest condition (a guess at the light that is left behind it). The maximum rises at once and decays slowly; the
minimum falls at once and rises slowly: both errors then cost time, not geometry.

An empty scene costs nothing: where no cell is occupied no ray has a sample. Updates look at every cell whatever the
rays do, so a field that becomes dense is found by the next full turn; but rays without samples teach a field nothing,
so that training must sample everywhere now and then (see `unseen` and hashnerf/fit.py).
"""

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from hashnerf.errors import UserError
from hashnerf.rays import Rays

LOG = logging.getLogger(__name__)
MAX_THICKNESS = 10.0  # exp(-10): opaque. A bounded spike decays below the threshold within a bounded number of updates
# Additive recurrence: consecutive points fill a cell evenly, so a thin pole is soon met. The powers of the plastic
# number fill the plane best, and most poles stand upright; the golden ratio goes well with them in height.
SEQUENCE = (1 / 1.324717957244746, 1 / 1.324717957244746**2, 2 / (1 + math.sqrt(5)))
USUAL_SHARE = 0.3  # of a new visit in the running mean: a visit tries only a few points
MOST_CELLS = 1 << 28  # a gigabyte for each of three numbers
CHUNK = 1 << 17  # positions evaluated at once
MOST_POINTS = 1024


@dataclass(frozen=True)
class OccupancyConfig:
    """Resolution and caution of the occupancy grid."""

    cell: float = 0.5
    """Largest edge of a cell, metres; 0 derives it from the scene (`hashnerf.capacity`)."""
    threshold: float = 0.01
    """A cell whose optical thickness stays below this in every condition is skipped."""
    decay: float = 0.95
    """Factor on the remembered maximum at each update of a cell."""
    points: int = 2
    """Positions tried in a cell at each update."""
    warmup: int = 4
    """Updates of the whole grid before any cell is skipped."""
    turns: int = 4
    """After the warm-up each update treats one cell in this many."""

    def __post_init__(self):
        if not 0 <= self.cell < math.inf:
            raise UserError(f"occupancy.cell is {self.cell}: use a positive number, or 0 to derive it from the scene")
        if not 0 < self.threshold < math.inf:
            raise UserError(f"occupancy.threshold is {self.threshold}: use a positive number")
        if not 0 < self.decay < 1:
            raise UserError(f"occupancy.decay is {self.decay}: use a number between 0 and 1")
        for name in ("points", "warmup", "turns"):
            if getattr(self, name) < 1:
                raise UserError(f"occupancy.{name} is {getattr(self, name)}: use at least 1")
        if self.points > MOST_POINTS:
            raise UserError(f"occupancy.points is {self.points}: use at most {MOST_POINTS}")


class OccupancyGrid(nn.Module):
    """Cells of a box with what they hold under a bank of conditions; all state is in buffers."""

    def __init__(self, config: OccupancyConfig, box: Float[Tensor, "2 3"]):
        super().__init__()
        if not config.cell:
            raise ValueError("occupancy.cell is 0: use fitted_to_scene first")
        self.config = config
        extent = (box[1] - box[0]).double()
        self.shape = tuple(max(1, math.ceil(side / config.cell - 1e-6)) for side in extent.tolist())
        if math.prod(self.shape) > MOST_CELLS:
            raise UserError(
                f"occupancy.cell is {config.cell:g} m: a scene box of {' x '.join(f'{side:.3g}' for side in extent)} m "
                f"has more than {MOST_CELLS:.0e} such cells; use larger cells or a smaller scene_box"
            )
        edges = extent / torch.tensor(self.shape)
        self.edge = float(edges.amax())  # crossing a cell along its longest edge
        cells = math.prod(self.shape)
        self.register_buffer("box", box.detach().float().clone(), persistent=False)
        self.register_buffer("inverse_edges", (1 / edges).float(), persistent=False)
        self.register_buffer("maximum", torch.zeros(cells))
        self.register_buffer("minimum", torch.zeros(cells))
        self.register_buffer("usual", torch.zeros(cells))
        self.register_buffer("updates", torch.zeros((), dtype=torch.int64))
        self.register_buffer("rejected", torch.zeros((), dtype=torch.int64))
        self.warned = self.warned_of_rejected = False

    def cell_index(self, positions: Float[Tensor, "n 3"]) -> Int[Tensor, " n"]:
        """Index of the cell of each position (m); positions outside the box count to the nearest cell."""
        place = (positions - self.box[0]) * self.inverse_edges
        return self._index(place.unbind(dim=1))

    def _index(self, place: Sequence[Tensor]) -> Tensor:
        """Flat cell index from lattice coordinates, axis by axis; overwrites them."""
        index = None
        for axis, count in zip(place, self.shape):
            cell = axis.clamp_(0, count - 1).to(torch.int32)
            index = cell if index is None else index.mul_(count).add_(cell)
        return index

    def lattice_of(self, cells: Int[Tensor, " n"]) -> Int[Tensor, "n 3"]:
        """Number of each cell along x, y and z, from its index."""
        _, ny, nz = self.shape
        return torch.stack([cells // (ny * nz), cells // nz % ny, cells % nz], dim=1)

    def densities_along(
        self, rays: Rays, t: Float[Tensor, "rays places"]
    ) -> tuple[Float[Tensor, "rays places"], Float[Tensor, "rays places"], Float[Tensor, "rays places"]]:
        """Densities (1/m) of the cells at distances t along rays: greatest (0 = skip), smallest and usual."""
        origin = (rays.origins - self.box[0]) * self.inverse_edges
        step = rays.directions * self.inverse_edges
        axes = [torch.addcmul(o[:, None], s[:, None], t) for o, s in zip(origin.unbind(dim=1), step.unbind(dim=1))]
        index = self._index(axes).view(-1)
        highest, lowest, usual = (table.index_select(0, index).view(t.shape) for table in self.densities())
        return highest, lowest, usual

    def occupied(self) -> Bool[Tensor, " cells"]:
        """Which cells rays must sample: all during the warm-up, none in an empty scene, of which a warning tells."""
        occupied = self.maximum > self.config.threshold
        if int(self.updates) < self.config.warmup:
            return torch.ones_like(occupied)
        if not bool(occupied.any()):
            if int(self.rejected):  # what was never a number was never seen to be empty: let the loss report it
                return torch.ones_like(occupied)
            if not self.warned:
                LOG.warning("the occupancy grid is empty: rays get no samples until an update finds something dense")
                self.warned = True
        return occupied

    def is_empty(self) -> bool:
        """Whether there is no cell that rays must sample."""
        return not bool(self.occupied().any())

    def unseen(self) -> "OccupancyGrid":
        """A grid of the same cells before its first update: rays sample it everywhere."""
        return OccupancyGrid(self.config, self.box.cpu()).to(self.box.device)

    def densities(self) -> tuple[Float[Tensor, " cells"], Float[Tensor, " cells"], Float[Tensor, " cells"]]:
        """Densities of each cell (1/m): greatest over the bank (0 = skip, never 0 where occupied), smallest, usual."""
        least = self.config.threshold  # an occupied cell of unknown or faded density still gets its share of samples
        highest = torch.where(self.occupied(), self.maximum.clamp(min=least), 0.0)
        lowest = self.minimum if int(self.updates) >= self.config.warmup else torch.zeros_like(self.minimum)
        return highest / self.edge, lowest / self.edge, self.usual / self.edge

    def occupied_fraction(self) -> float:
        """Share of the cells that rays sample."""
        return float(self.occupied().float().mean())

    @torch.no_grad()
    def update(self, density_bank: Callable[[Float[Tensor, "p 3"]], Float[Tensor, "bank p"]]) -> None:
        """Refresh cells from the density (1/m) of positions under each condition of a bank.

        The first updates treat all cells, later ones one cell in `turns`. A cell with a density that is not finite
        keeps its old values and is counted in `rejected`.
        """
        number = int(self.updates)
        turns = 1 if number < self.config.warmup else self.config.turns
        device = self.maximum.device
        cells = torch.arange(self.maximum.numel(), device=device)[number % turns :: turns]
        # counts on through the visits of one cell, so that its points keep filling it evenly
        visit = number if turns == 1 else self.config.warmup + (number - self.config.warmup) // turns
        for chunk in cells.split(CHUNK // self.config.points):
            self._update_cells(chunk, visit, density_bank)
        self.updates += 1
        if not self.warned_of_rejected and int(self.rejected):
            LOG.warning("a density is not finite: its cells keep what they held, and `rejected` counts them")
            self.warned_of_rejected = True

    def _update_cells(self, cells: Tensor, visit: int, density_bank: Callable) -> None:
        highest = torch.zeros(len(cells), device=cells.device)
        lowest = torch.full_like(highest, MAX_THICKNESS)
        finite = torch.ones_like(cells, dtype=torch.bool)
        total: Tensor | float = 0.0
        for point in range(self.config.points):
            thickness = density_bank(self._points(cells, visit * self.config.points + point)).float() * self.edge
            finite &= thickness.isfinite().all(dim=0)
            highest = torch.maximum(highest, thickness.amax(dim=0))
            lowest = torch.minimum(lowest, thickness.amin(dim=0))
            total = total + thickness.clamp(max=MAX_THICKNESS)
        old_maximum, old_minimum = self.maximum[cells], self.minimum[cells]
        maximum = torch.maximum(old_maximum * self.config.decay, highest.clamp(max=MAX_THICKNESS))
        minimum = torch.minimum(lowest, (old_minimum + lowest) / 2)
        self.maximum[cells] = torch.where(finite, maximum, old_maximum)
        self.minimum[cells] = torch.where(finite, minimum, old_minimum)
        old_usual = self.usual[cells]
        usual = old_usual + USUAL_SHARE * ((total / self.config.points).amin(dim=0) - old_usual)
        self.usual[cells] = torch.where(finite, usual, old_usual)
        self.rejected += (~finite).sum()

    def _points(self, cells: Tensor, number: int) -> Float[Tensor, "p 3"]:
        """One point in each cell: the `number`-th of a sequence that fills the cell evenly."""
        offset = torch.tensor([(0.5 + step * number) % 1.0 for step in SEQUENCE], device=cells.device)
        return self.box[0] + (self.lattice_of(cells) + offset) / self.inverse_edges
