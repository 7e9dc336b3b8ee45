"""Multi-resolution hash grid (Instant-NGP) over an axis-aligned box of any shape.

Every level is a lattice of cubic cells: `resolution` cells along the longest side of the box and as many as needed
along the others; `flatness` makes cells that many times lower than wide, for scenes of flat ground. A point takes the
trilinear mean of the feature vectors at the eight vertices of its cell. Vertices are stored one by one where they fit
into the table, else they share entries through a spatial hash.

Positions are world metres. They are always computed in float32 (float64 stays float64), also under autocast. A point
outside the box, or NaN, gets zero features and no gradient; under `torch.autograd.detect_anomaly` NaN raises
ValueError.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from hashnerf.activations import at_least_float32
from hashnerf.compiling import compiled_or_eager
from hashnerf.errors import UserError

INITIAL_RANGE = 1e-4
# 2654435761 as a signed 32-bit number: the hash of Instant-NGP is a product modulo 2^32, which int32 gives by wrapping
PRIMES = (1, 2654435761 - (1 << 32), 805459861)
MOST_NUMBERS = 1 << 31  # of one level: places within a level are computed in 32 bits


@dataclass(frozen=True)
class Level:
    """One lattice: its cell size, its vertices per axis and its stretch of the table."""

    cell: float
    """Edge of a cell, metres; along z divided by the flatness."""
    vertices: tuple[int, int, int]
    """Lattice vertices along x, y and z."""
    entries: int
    """Feature vectors stored."""
    offset: int
    """Index of the first number of this level in the one-dimensional table."""
    hashed: bool
    """Whether vertices share entries through the hash."""


def plan_levels(
    extent: tuple[float, float, float],
    levels: int,
    features: int,
    log2_table_size: int,
    base_resolution: int,
    finest_resolution: int,
    flatness: float = 1.0,
) -> tuple[Level, ...]:
    """Lay out `levels` lattices whose resolutions grow geometrically from base to finest along the longest side."""
    longest, table_size = max(extent), 1 << log2_table_size
    growth = (finest_resolution / base_resolution) ** (1 / max(levels - 1, 1))
    sides = (*extent[:2], extent[2] * flatness)
    plan, offset = [], 0
    for number in range(levels):
        resolution = round(base_resolution * growth**number)
        vertices = tuple(math.ceil(resolution * side / longest) + 1 for side in sides)
        count = math.prod(vertices)  # Python integers: 2048^3 would overflow 32 bits
        hashed = count > table_size
        entries = table_size if hashed else count
        plan.append(Level(longest / resolution, vertices, entries, offset, hashed))
        offset += entries * features
    return tuple(plan)


def spatial_hash(vertex: Int[Tensor, "n 3"], table_size: int) -> Int[Tensor, " n"]:
    """Hash lattice vertices into [0, table_size) by the exclusive or of coordinate times prime, modulo 2^32.

    Raises ValueError unless `table_size` is a power of two: only then does masking equal the unsigned remainder.
    """
    if table_size < 1 or table_size & (table_size - 1):
        raise ValueError(f"hash table size {table_size} is not a power of two")
    x, y, z = vertex.to(torch.int32).unbind(dim=1)
    return (x ^ (y * PRIMES[1]) ^ (z * PRIMES[2])) & (table_size - 1)


# Kernels work on planes: coordinates [3, n], features [features, n]. Along a plane both the compiler and the library
# use the processor's wide registers; along the two features of a point most of them would stay empty. Every kernel
# takes one level: lattice coordinates x, its table [entries * features], and what `HashGrid.lattice` tells.


def _cell(x: Tensor, last_cell: Tensor) -> tuple[Tensor, Tensor]:
    """Split lattice coordinates into cell index and fraction; the upper face belongs to the last cell (fraction 1)."""
    cell = torch.minimum(torch.floor(x), last_cell.to(x.dtype)[:, None])
    return cell.to(torch.int32), x - cell


def _sides(fraction: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Weights [2, n] of the lower and the upper vertex along each axis."""
    return torch.stack([1 - fraction, fraction], dim=1).unbind()


def _corners(
    x: Tensor, last_cell: Tensor, multiplier: Tensor, mask: int, hashed: bool
) -> tuple[Int[Tensor, "8 n"], Float[Tensor, "8 n"]]:
    """Table entries of a cell's eight vertices, x slowest, and their trilinear weights: a few operations on large
    tensors, for the library."""
    cell, fraction = _cell(x, last_cell)
    low = cell * multiplier[:, None]
    x, y, z = torch.stack([low, low + multiplier[:, None]], dim=1)
    across, along, up = _sides(fraction)
    weight = (across[:, None] * along)[:, :, None] * up
    index = ((x[:, None] ^ y)[:, :, None] ^ z) & mask if hashed else (x[:, None] + y)[:, :, None] + z
    return index.view(8, -1), weight.view(8, -1)


def _corners_one_by_one(
    x: Tensor, last_cell: Tensor, multiplier: Tensor, mask: int, hashed: Tensor
) -> tuple[list[Tensor], list[Tensor]]:
    """The same as eight planes each: many operations, for the compiler, which fuses them and stores none of them.

    `hashed` is a tensor, so that all levels share one compiled kernel.
    """
    cell, fraction = _cell(x, last_cell)
    low = cell * multiplier[:, None]
    x, y, z = zip(low, low + multiplier[:, None])
    pairs = [(a ^ b, a + b) for a, b in product(x, y)]
    indices = [torch.where(hashed, (mixed ^ c) & mask, sum_ + c) for (mixed, sum_), c in product(pairs, z)]
    across, along, up = zip(1 - fraction, fraction)
    shares = [a * b for a, b in product(across, along)]
    return indices, [share * c for share, c in product(shares, up)]


def _gather(x: Tensor, table: Tensor, features: int, *lattice) -> Tensor:
    """Interpolate one level in one pass over the points."""
    total = [torch.zeros_like(x[0]) for _ in range(features)]
    for index, weight in zip(*_corners_one_by_one(x, *lattice)):
        first = index * features
        total = [plane + table[first + feature] * weight for feature, plane in enumerate(total)]
    return torch.stack(total)


def _gather_eager(x: Tensor, table: Tensor, features: int, *lattice) -> Tensor:
    """The same without a compiler."""
    index, weight = _corners(x, *lattice)
    return torch.stack([(values * weight).sum(dim=0) for values in _look_up(table, index, features)])


def _look_up(table: Tensor, index: Tensor, features: int) -> list[Tensor]:
    """Each feature of some entries."""
    first = index.view(-1) * features
    return [table[feature:].index_select(0, first).view(index.shape) for feature in range(features)]


def _spread(x: Tensor, gradient: Tensor, *lattice) -> tuple[Tensor, Tensor]:
    """Return the table entries [8, n] that a point's gradient goes to and its eight shares [features / 2, 8, n, 2]."""
    indices, weights = _corners_one_by_one(x, *lattice)
    weight = torch.stack(weights)
    pairs = zip(gradient[0::2], gradient[1::2])
    return torch.stack(indices), torch.stack([torch.stack([a * weight, b * weight], dim=-1) for a, b in pairs])


def _spread_eager(x: Tensor, gradient: Tensor, *lattice) -> tuple[Tensor, Tensor]:
    """The same without a compiler."""
    index, weight = _corners(x, *lattice)
    shares = gradient[:, None] * weight
    return index, torch.view_as_real(torch.complex(shares[0::2], shares[1::2]))


def _slope(x: Tensor, gradient: Tensor, table: Tensor, *lattice) -> Tensor:
    """Gradient with respect to the lattice coordinates [3, n]."""
    index, _ = _corners(x, *lattice)
    across, along, up = _sides(_cell(x, lattice[0])[1])
    pull = sum(values * plane for values, plane in zip(_look_up(table, index, len(gradient)), gradient))
    pull = pull.view(2, 2, 2, -1)
    return torch.stack(
        [
            ((pull[1] - pull[0]) * along[:, None] * up).sum(dim=(0, 1)),
            ((pull[:, 1] - pull[:, 0]) * across[:, None] * up).sum(dim=(0, 1)),
            ((pull[:, :, 1] - pull[:, :, 0]) * across[:, None] * along).sum(dim=(0, 1)),
        ]
    )


def _add_shares(table: Tensor, index: Tensor, shares: Tensor) -> None:
    """Add shares [features / 2, 8, n, 2] to entries [8, n] of a table in place; pairs travel as one complex number.

    One-dimensional `index_add_` over complex numbers is the fastest scatter of PyTorch on a processor.
    """
    target, index = torch.view_as_complex(table.view(-1, 2)), index.view(-1)
    pairs = len(shares)
    for pair, numbers in enumerate(torch.view_as_complex(shares)):
        target.index_add_(0, index if pairs == 1 else index * pairs + pair, numbers.reshape(-1))


class _Encode(torch.autograd.Function):
    """Stores the points alone: indices and weights are cheaper to compute again than to keep."""

    @staticmethod
    def forward(ctx, local: Tensor, inside: Tensor, table: Tensor, grid: "HashGrid") -> Tensor:
        ctx.save_for_backward(local, inside, table)
        ctx.grid = grid
        gather, lattice = grid.kernel(_gather, _gather_eager)
        planes = local.t().contiguous()
        parts = [
            gather(planes * (1 / level.cell), grid.numbers(table, level), grid.features, *lattice(number))
            for number, level in enumerate(grid.plan)
        ]
        return torch.cat(parts).mul_(inside).t()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, gradient: Tensor) -> tuple[Tensor | None, None, Tensor | None, None]:
        local, inside, table = ctx.saved_tensors
        grid = ctx.grid
        spread, lattice = grid.kernel(_spread, _spread_eager)
        planes = local.t().contiguous()
        columns = (gradient.t().contiguous() * inside).split(grid.features)
        for_positions = torch.zeros_like(planes) if ctx.needs_input_grad[0] else None
        for_table = torch.zeros_like(table) if ctx.needs_input_grad[2] else None
        for number, level in enumerate(grid.plan):
            x, column = planes * (1 / level.cell), columns[number]
            if for_table is not None:
                index, shares = spread(x, column, *lattice(number))
                _add_shares(grid.numbers(for_table, level), index, shares)
            if for_positions is not None:
                slope = _slope(x, column, grid.numbers(table, level), *grid.lattice(number))
                for_positions += slope * (1 / level.cell)
        return None if for_positions is None else for_positions.t(), None, for_table, None


class HashGrid(nn.Module):
    """Trainable multi-resolution features of positions in a box."""

    def __init__(
        self,
        box: Float[Tensor, "2 3"],
        levels: int,
        features: int,
        log2_table_size: int,
        base_resolution: int,
        finest_resolution: int,
        compile: bool = False,
        flatness: float = 1.0,
    ):
        super().__init__()
        if features % 2:
            raise UserError(f"features_per_level is {features}: use an even number")
        self.features, self.compile, self.flatness = features, compile, flatness
        extent = (box[1].double() - box[0].double()).tolist()
        if not all(0 < side < math.inf for side in extent):
            raise UserError(f"scene box has sides {extent} m: every side must be positive and finite")
        self.plan = plan_levels(
            tuple(extent), levels, features, log2_table_size, base_resolution, finest_resolution, flatness
        )
        self.register_buffer("box", box.detach().clone(), persistent=False)
        last = self.plan[-1]
        if max(last.vertices) >= MOST_NUMBERS:
            raise UserError(
                f"finest_resolution {finest_resolution:.3g} and flatness {flatness:g} ask for "
                f"{max(last.vertices):.1e} cells along a side: use smaller ones"
            )
        most = max(level.entries for level in self.plan)
        if most * features > MOST_NUMBERS:
            raise UserError(
                f"a hash grid level of {most} entries with features_per_level {features} holds more than "
                f"{MOST_NUMBERS} numbers: use a smaller log2_table_size or fewer features"
            )
        numbers = last.offset + last.entries * features
        self.table = nn.Parameter(torch.empty(numbers).uniform_(-INITIAL_RANGE, INITIAL_RANGE))
        last_cells = [[count - 2 for count in level.vertices] for level in self.plan]
        multipliers = [PRIMES if v.hashed else (1, v.vertices[0], v.vertices[0] * v.vertices[1]) for v in self.plan]
        self.register_buffer("last_cells", torch.tensor(last_cells, dtype=torch.int32), persistent=False)
        self.register_buffer("hashed", torch.tensor([v.hashed for v in self.plan]), persistent=False)
        self.register_buffer("multipliers", torch.tensor(multipliers, dtype=torch.int32), persistent=False)

    @property
    def out_features(self) -> int:
        """Length of the feature vector of a position."""
        return len(self.plan) * self.features

    def numbers(self, table: Tensor, level: Level) -> Tensor:
        """View of one level of a table-shaped tensor, entry by entry, as [entries * features]."""
        return table[level.offset : level.offset + level.entries * self.features]

    def rows(self, table: Tensor, level: Level) -> Tensor:
        """The same as [entries, features]."""
        return self.numbers(table, level).view(level.entries, self.features)

    def lattice(self, number: int) -> tuple[Tensor, Tensor, int, bool]:
        """The numbers that turn lattice coordinates into table entries at one level."""
        level = self.plan[number]
        return self.last_cells[number], self.multipliers[number], level.entries - 1, level.hashed

    def kernel(self, fused: Callable, eager: Callable) -> tuple[Callable, Callable[[int], tuple]]:
        """Returns a kernel, compiled if that is asked for and possible, and the lattice of a level as it wants it."""
        chosen = compiled_or_eager(fused, eager, self.compile)
        if chosen is eager:
            return eager, self.lattice
        return chosen, lambda number: (*self.lattice(number)[:3], self.hashed[number])

    def forward(self, positions: Float[Tensor, "n 3"]) -> Float[Tensor, "n features"]:
        """Encode world positions (m); outside the box and for NaN the features are zero, without gradient."""
        if torch.is_anomaly_enabled() and bool(positions.isnan().any()):
            raise ValueError("a position is NaN")
        positions = at_least_float32(positions)
        low, high = self.box.to(positions.dtype)
        inside = ((positions >= low) & (positions <= high)).all(dim=1)
        # the argument itself is made safe: a NaN that is only masked afterwards still reaches the gradient
        local = torch.where(inside[:, None], positions - low, 0.0)
        if self.flatness != 1.0:
            local = local * local.new_tensor([1.0, 1.0, self.flatness])
        return _Encode.apply(local, inside, self.table, self)
