"""What the ego's camera sees in an embedded world, from anywhere on its route."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from carff.driving import Drive, actor_poses
from worlds.scenarios import world_from_description
from worlds.scene import Scene, World, ego_camera

Look = Callable[[list[Drive]], Tensor]
"""Renders what the cameras of some drives see, [drives, h, w, 3]."""
MOST_PICTURES = 4000  # of 128 x 128 pixels: 200 MB


@dataclass(frozen=True)
class Camera:
    """Renders what the ego sees; `description` is the data set's `world` entry."""

    description: dict
    width: int
    height: int

    def renderer(self) -> Callable[[Drive], np.ndarray]:
        """Returns what renders, as worker processes ask for it."""
        return self.picture

    def picture(self, drive: Drive) -> np.ndarray:
        """Returns the uint8 picture [h, w, 3] from the ego's camera at a moment."""
        world = world_from_description(self.description)
        camera = ego_camera(world, world.traffic.routes["ego"].pose(drive.s)).scaled(self.width, self.height)
        return Scene(world, actor_poses(world, drive.setup, drive.time)).render(camera).rgb


def remembering(world: World, render: Callable[[list[Drive]], list[np.ndarray]]) -> Look:
    """Returns a renderer that renders no scene twice: rules start alike, and an ego that stands may see no change."""
    known: dict[tuple, np.ndarray] = {}

    def key(drive: Drive) -> tuple:
        return (drive.s, *actor_poses(world, drive.setup, drive.time).items())

    def look(drives: list[Drive]) -> Tensor:
        keys = [key(drive) for drive in drives]
        if len(known) > MOST_PICTURES:
            known.clear()
        new = {one: drive for one, drive in zip(keys, drives) if one not in known}
        known.update(zip(new, render(list(new.values()))))
        return torch.from_numpy(np.stack([known[one] for one in keys]))

    return look
