"""The paths to be driven, as `trajectories` in transforms.json tells them: name -> [[x, y], ...], metres.

A path that ends where it begins is driven round and round.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from aerial2ground.paths import Path
from aerial2ground.road_network import RoadNetwork
from hashnerf.errors import UserError
from hashnerf.training_run import RUN_NAME


def read_trajectories(entry: Any, network: RoadNetwork, origin: Float[Tensor, " 3"], source: str) -> dict[str, Path]:
    """Returns the paths of a data set in the frame of its loaded poses; raises UserError for what cannot be driven."""
    if not isinstance(entry, Mapping) or not entry:
        raise UserError(f"{source}: has no trajectories; add the paths to be driven, name -> [[x, y], ...]")
    for name in entry:
        # folders of views and networks are named after them
        if not RUN_NAME.fullmatch(name):
            raise UserError(
                f"{source}: trajectories holds the name {name!r}; use 1 to 64 letters, digits, '.', '_' or '-', "
                "starting with a letter or digit"
            )
    return {name: _path(name, points, network, origin, source) for name, points in entry.items()}


def _path(name: str, points: Any, network: RoadNetwork, origin: Tensor, source: str) -> Path:
    try:
        line = np.array(points, dtype=float)
    except (TypeError, ValueError):
        line = np.zeros(0)
    if line.ndim != 2 or line.shape[1] != 2 or not np.isfinite(line).all():
        raise UserError(f"{source}: trajectories.{name} must be points [x, y] in metres")
    line = line - origin[:2].numpy()
    try:
        path = Path(line)
    except UserError as error:
        raise UserError(f"{source}: trajectories.{name}: {error}") from error
    far = ~(network.distance(torch.from_numpy(line).float()) <= network.width)  # not a number is far, too
    if bool(far.any()):
        place = (line + origin[:2].numpy())[int(far.nonzero()[0])]
        raise UserError(
            f"{source}: trajectories.{name} leaves the road network at [{place[0]:.2f}, {place[1]:.2f}]; "
            "draw it on the roads, or draw the road"
        )
    return path
