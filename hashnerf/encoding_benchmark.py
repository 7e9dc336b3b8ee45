"""What the hash-grid encoding costs, beside the way it is usually written in PyTorch.

`plain_encoding` is that way: for each level the eight vertices of every cell are gathered one after the other, and
autograd keeps what backward needs. It reads the same table, so both give the same features.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product

import torch
from jaxtyping import Float
from torch import Tensor

from hashnerf.errors import UserError
from hashnerf.hash_grid import HashGrid, spatial_hash
from hashnerf.report_tables import Table
from hashnerf.timing import seconds_in_turns


@dataclass(frozen=True)
class EncodingBenchmark:
    """What is encoded, and how often."""

    points: int = 65536
    """Points at random places of a cube."""
    levels: int = 16
    """Levels of the grid."""
    features: int = 2
    """Features per level."""
    log2_table_size: int = 17
    """Binary logarithm of the most entries of a level."""
    base_resolution: int = 16
    """Cells along a side at the coarsest level."""
    finest_resolution: int = 2048
    """Cells along a side at the finest level."""
    turns: int = 9
    """Turns of which the median is taken."""
    device: str = "cpu"
    """Where it runs: cpu or cuda."""

    def __post_init__(self):
        for key in ("points", "levels", "turns"):
            if getattr(self, key) < 1:
                raise UserError(f"{key} is {getattr(self, key)}; give at least 1")
        if self.device not in ("cpu", "cuda") or (self.device == "cuda" and not torch.cuda.is_available()):
            raise UserError(f"device is {self.device}; give cpu, or cuda where there is a GPU")


def plain_encoding(grid: HashGrid, positions: Float[Tensor, "n 3"]) -> Float[Tensor, "n features"]:
    """Returns the features of positions (m) inside the box: eight gathers a level, differentiable by autograd."""
    columns = []
    for number, level in enumerate(grid.plan):
        last_cell, multiplier, _, _ = grid.lattice(number)
        x = (positions - grid.box[0]) / level.cell
        cell = torch.minimum(x.floor(), last_cell)
        fraction, vertex, rows = x - cell, cell.int(), grid.rows(grid.table, level)
        total = torch.zeros_like(rows[:1])
        for corner in product((0, 1), repeat=3):
            ahead = vertex.new_tensor(corner)
            place = vertex + ahead
            index = spatial_hash(place, level.entries) if level.hashed else (place * multiplier).sum(dim=1)
            weight = torch.where(ahead.bool(), fraction, 1 - fraction).prod(dim=1)
            total = total + rows[index.long()] * weight[:, None]
        columns.append(total)
    return torch.cat(columns, dim=1)


def time_encodings(config: EncodingBenchmark) -> dict[str, float]:
    """Returns median seconds: `<way> forward` and `<way> both` (with backward into the table) of every way."""
    torch.manual_seed(0)
    box = torch.tensor([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    size = (config.levels, config.features, config.log2_table_size, config.base_resolution, config.finest_resolution)
    compiled = HashGrid(box, *size, compile=True).to(config.device)
    eager = HashGrid(box, *size).to(config.device)
    positions = torch.rand(config.points, 3, device=config.device)
    pull = torch.randn(config.points, eager.out_features, device=config.device)
    ways = {
        "plain": (eager, lambda: plain_encoding(eager, positions)),
        "eager": (eager, lambda: eager(positions)),
        "compiled": (compiled, lambda: compiled(positions)),
    }

    functions = {}
    for name, (grid, encode) in ways.items():
        functions[f"{name} forward"] = torch.no_grad()(encode)
        functions[f"{name} both"] = partial(_both, grid, encode, pull)
    return seconds_in_turns(functions, config.turns)


def _both(grid: HashGrid, encode: Callable[[], Tensor], pull: Tensor) -> None:
    grid.table.grad = None
    encode().backward(pull)


def encoding_table(seconds: dict[str, float]) -> Table:
    """Returns times, and how many times faster than the plain way each is."""
    ways = list(dict.fromkeys(name.split()[0] for name in seconds))
    rows = tuple(
        (
            way,
            *(f"{seconds[f'{way} {part}'] * 1000:.1f} ms" for part in ("forward", "both")),
            *(f"{seconds[f'plain {part}'] / seconds[f'{way} {part}']:.1f}" for part in ("forward", "both")),
        )
        for way in ways
    )
    return Table(("encoding", "forward", "forward and backward", "times faster: forward", "both"), rows)
