"""Worlds and scenes: a world is everything that a (config, seed) pair fixes; a scene is that world with its moving
bodies at given poses. Object ids: 1.. for the static bodies in order, then the actors in the order of `world.actors`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from torch import Tensor

from hashnerf.cameras import Cameras
from worlds.boxes import Box, Pose, box_at
from worlds.meshes import Mesh
from worlds.raycast import Caster
from worlds.rig import CLEARANCE, Mount, pinholes
from worlds.routes import Traffic
from worlds.shading import Light
from worlds.view import LitBodies, StaticView, View


@dataclass(frozen=True)
class Actor:
    """A body that moves between states: its mesh in its own frame and the size of its box, metres."""

    mesh: Mesh
    size: tuple[float, float, float]


@dataclass(frozen=True)
class State:
    """One moment of one possible world; `hazard` says that advancing from here is unsafe."""

    branch: int
    step: int
    hazard: bool
    poses: Mapping[str, Pose]
    """Where each actor stands; an actor that is missing is absent."""


@dataclass(frozen=True)
class Rig:
    """The cameras of a data set with their kinds and splits, one entry a camera."""

    cameras: Cameras
    kinds: tuple[str, ...]
    splits: tuple[str, ...]
    told: Float[Tensor, "n 4 4"] | None = None
    """Poses as a data set tells them, where they are not exact."""


@dataclass(frozen=True)
class World:
    """Everything that a scenario's config and seed fix."""

    scenario: str
    seed: int
    config: Any
    branches: tuple[str, ...]
    static: tuple[tuple[str, Mesh], ...]
    actors: Mapping[str, Actor]
    states: tuple[State, ...]
    light: Light
    scene_box: Float[np.ndarray, "2 3"]
    rig: Rig
    branch_weights: tuple[float, ...] | None = None
    """How often each branch happens; alike if None."""
    mount: Mount | None = None
    """The ego's camera; None where nothing drives."""
    traffic: Traffic | None = None
    """Routes, speeds and conflict zones; None where nothing drives."""
    extras: Mapping[str, Any] = field(default_factory=dict)
    """Further top-level entries of the data set's transforms.json."""

    @cached_property
    def stage(self) -> LitBodies:
        """The static world, ready for casting; built once."""
        return LitBodies(Caster([(number, mesh) for number, (_, mesh) in enumerate(self.static, 1)]), self.light)

    def object_id(self, name: str) -> int:
        """The id of a static body or an actor in id images."""
        return [*(label for label, _ in self.static), *self.actors].index(name) + 1


class Scene:
    """A world with its actors at given poses; an actor without a pose is absent."""

    def __init__(self, world: World, poses: Mapping[str, Pose]):
        self.world, self.poses = world, dict(poses)
        meshes = [(world.object_id(name), self.mesh(name)) for name in world.actors if name in poses]
        self.bodies = LitBodies(Caster(meshes), world.light)

    def mesh(self, name: str) -> Mesh:
        """An actor's mesh in the world."""
        pose = self.poses[name]
        return self.world.actors[name].mesh.placed(pose.x, pose.y, pose.z, pose.yaw)

    def box(self, name: str) -> Box:
        """An actor's box in the world."""
        return box_at(self.poses[name], self.world.actors[name].size)

    def render(self, cameras: Cameras, index: int = 0) -> View:
        """Colour, depth and object ids from one camera."""
        return StaticView(self.world.stage, cameras, index).with_bodies(self.bodies)


def ego_camera(world: World, ego: Pose) -> Cameras:
    """The camera just ahead of the front bumper of an ego that stands at `ego`: one row, 128 px (use `scaled`)."""
    assert world.mount is not None and world.traffic is not None, f"nothing drives in {world.scenario}"
    ahead = world.actors["ego"].size[0] / 2 + CLEARANCE
    ground = Pose(ego.x + ahead * math.cos(ego.yaw), ego.y + ahead * math.sin(ego.yaw), ego.z, ego.yaw)
    s = world.traffic.routes["ego"].nearest(ground.x, ground.y)
    return pinholes([world.mount.pose(ground, s)], [world.mount.field_of_view])
