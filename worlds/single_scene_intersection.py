"""Single-scene approaching intersection (CARFF 4.1 a): the ego waits at the junction while a truck crosses in ten even
steps. One branch and no parked cars: what is learnt here is the order of time under full observation.
"""

from dataclasses import dataclass, field

import numpy as np

from worlds.checks import check_between
from worlds.crossing import (
    crossing_actors,
    crossing_mount,
    crossing_rig,
    crossing_traffic,
    ego_pose,
    truck_pose,
)
from worlds.crossing_street import SCENE_BOX, street_bodies
from worlds.scene import State, World
from worlds.settings import EgoCameraConfig, SplitConfig
from worlds.shading import Light

STEPS = 10
TRUCK_SIZE = (4.4, 2.1, 2.4)
RIG_START = -26.0
"""x of the first ego camera."""
BIRDS_EYE = (-5.0, 0.0, 54.0)
"""It sees every place of ego and truck in the data set."""
HAZARD_STEPS = 2
"""The truck is a hazard when it will be in the conflict zone within this many steps."""


@dataclass(frozen=True)
class SingleSceneIntersectionConfig:
    """Settings of the single-scene intersection."""

    ego_x: float = -11.0
    """x of the waiting ego's centre, metres; the junction is at 0."""
    truck_start: float = 20.2
    """y of the truck's centre at step 0, metres; it drives towards -y."""
    truck_step: float = 4.5
    """Metres that the truck advances in a step; more than its length, so that its boxes never overlap."""
    step_seconds: float = 0.6
    """Seconds from one step to the next."""
    jitter: float = 1.0
    """How far the seed may move sizes, plants and parked cars: 0 (not at all) to 1."""
    light: Light = field(default_factory=Light)
    """The sun."""
    ego_camera: EgoCameraConfig = field(default_factory=EgoCameraConfig)
    """The camera that the ego carries."""
    splits: SplitConfig = field(default_factory=SplitConfig)
    """Which cameras are held out."""

    def __post_init__(self) -> None:
        check_between("ego_x", self.ego_x, -13.0, -10.5)
        check_between("truck_start", self.truck_start, 18.0, 22.0)
        check_between("truck_step", self.truck_step, 4.41, 4.6)
        check_between("step_seconds", self.step_seconds, 0.1, 10.0)
        check_between("jitter", self.jitter, 0.0, 1.0)


def build_single_scene_intersection(config: SingleSceneIntersectionConfig, seed: int) -> World:
    """The world of one (config, seed)."""
    layout, rig_noise, actor_noise = (np.random.default_rng([seed, stream]) for stream in range(3))
    actors = crossing_actors(TRUCK_SIZE, config.jitter, actor_noise)
    mount = crossing_mount(config.ego_camera)
    poses = [
        {"ego": ego_pose(config.ego_x), "truck": truck_pose(config.truck_start - config.truck_step * step)}
        for step in range(STEPS)
    ]
    states = [State(0, step, False, pose) for step, pose in enumerate(poses)]
    traffic = crossing_traffic(states, actors["truck"].size, config.step_seconds)
    # Unsafe to advance while the truck is in the junction or about to enter it.
    enter, leave = traffic.conflicts["truck"][1]
    states = [
        State(0, step, enter - HAZARD_STEPS * config.truck_step <= traffic.starts[0, step, "truck"] <= leave, pose)
        for step, pose in enumerate(poses)
    ]
    return World(
        scenario="single_scene_intersection",
        seed=seed,
        config=config,
        branches=("crossing",),
        static=tuple(street_bodies(layout, config.jitter, parked=False)),
        actors=actors,
        states=tuple(states),
        light=config.light,
        scene_box=SCENE_BOX,
        rig=crossing_rig(mount, [config.ego_x], RIG_START, BIRDS_EYE, config.splits, rig_noise),
        mount=mount,
        traffic=traffic,
    )
