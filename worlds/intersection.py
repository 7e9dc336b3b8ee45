"""Multi-scene approaching intersection (CARFF 4.1 b): does a truck come out of the hidden crossing road or not?

Branch 0 'absent', branch 1 'present'. In each of three steps the ego is `ego_step` metres further on, and so is the
truck by `truck_step`. The corner building and a parked van hide it until late.
"""

from dataclasses import dataclass, field

import numpy as np

from worlds.checks import check_between
from worlds.crossing import (
    EGO_SIZE,
    crossing_actors,
    crossing_mount,
    crossing_rig,
    crossing_traffic,
    ego_pose,
    truck_pose,
)
from worlds.crossing_street import SCENE_BOX, street_bodies
from worlds.rig import CLEARANCE
from worlds.scene import State, World
from worlds.settings import EgoCameraConfig, SplitConfig
from worlds.shading import Light

STEPS = 3
TRUCK_SIZE = (6.0, 2.4, 2.8)
RIG_START = -34.0
"""x of the first ego camera."""
BIRDS_EYE = (-13.0, 9.5, 44.0)
"""It sees every place of ego and truck in the data set."""


@dataclass(frozen=True)
class IntersectionConfig:
    """Settings of the multi-scene intersection."""

    ego_start: float = -27.0
    """x of the ego's centre at step 0, metres; the junction is at 0."""
    ego_step: float = 8.0
    """Metres that the ego advances in a step."""
    truck_start: float = 20.7
    """y of the truck's centre at step 0, metres; it drives towards -y."""
    truck_step: float = 7.4
    """Metres that the truck advances in a step; more than its length, so that its boxes never overlap."""
    step_seconds: float = 1.0
    """Seconds from one step to the next, for driving in closed loop."""
    jitter: float = 1.0
    """How far the seed may move sizes, plants, parked cars and the truck: 0 (not at all) to 1."""
    light: Light = field(default_factory=Light)
    """The sun."""
    ego_camera: EgoCameraConfig = field(default_factory=EgoCameraConfig)
    """The camera that the ego carries."""
    splits: SplitConfig = field(default_factory=SplitConfig)
    """Which cameras are held out."""

    def __post_init__(self) -> None:
        check_between("ego_start", self.ego_start, -29.0, -25.0)
        check_between("ego_step", self.ego_step, EGO_SIZE[0] + 2 * CLEARANCE + 1.0, 8.5)
        check_between("truck_start", self.truck_start, 15.0, 25.0)
        check_between("truck_step", self.truck_step, 6.5, 9.0)
        check_between("step_seconds", self.step_seconds, 0.1, 10.0)
        check_between("jitter", self.jitter, 0.0, 1.0)


def build_intersection(config: IntersectionConfig, seed: int) -> World:
    """The world of one (config, seed)."""
    layout, rig_noise, actor_noise = (np.random.default_rng([seed, stream]) for stream in range(3))
    actors = crossing_actors(TRUCK_SIZE, config.jitter, actor_noise)
    shift = 0.2 * config.jitter * float(actor_noise.uniform(-1.0, 1.0))
    ego_x = [config.ego_start + config.ego_step * step for step in range(STEPS)]
    truck_y = [config.truck_start + shift - config.truck_step * step for step in range(STEPS)]
    states = []
    for branch in (0, 1):
        for step in range(STEPS):
            poses = {"ego": ego_pose(ego_x[step])}
            if branch == 1:
                poses["truck"] = truck_pose(truck_y[step])
            states.append(State(branch, step, branch == 1, poses))
    mount = crossing_mount(config.ego_camera)
    return World(
        scenario="intersection",
        seed=seed,
        config=config,
        branches=("absent", "present"),
        static=tuple(street_bodies(layout, config.jitter, parked=True)),
        actors=actors,
        states=tuple(states),
        light=config.light,
        scene_box=SCENE_BOX,
        rig=crossing_rig(mount, ego_x, RIG_START, BIRDS_EYE, config.splits, rig_noise),
        mount=mount,
        traffic=crossing_traffic(states, actors["truck"].size, config.step_seconds),
    )
