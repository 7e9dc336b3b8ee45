"""Two-lane merge (CARFF 4.1 c): the ego comes up a ramp into a lane in which a lead car and a second car approach.

Branch 0 'fast': the second car reaches the merge together with the ego. Branch 1 'slow': it stays behind. Both
branches share their first state.
"""

from dataclasses import dataclass, field

import numpy as np

from hashnerf.cameras import look_at
from worlds.boxes import Pose
from worlds.checks import check_between
from worlds.merge_street import AREA, RAMP_LENGTH, SCENE_BOX, ego_route, street_bodies
from worlds.rig import CLEARANCE, Mount, interleaved_splits, lane_poses, pinholes, ring_poses
from worlds.routes import Route, nominal_traffic, straight
from worlds.scene import Actor, Rig, State, World
from worlds.settings import EgoCameraConfig, SplitConfig
from worlds.shading import Light
from worlds.vehicles import sedan

STEPS = 3
EGO_SIZE = (4.5, 1.8, 1.42)
LEAD_SIZE = (4.3, 1.8, 1.45)
SECOND_SIZE = (3.6, 1.7, 1.5)
LINE = RAMP_LENGTH - 0.4
"""Arc length of the yield line on the ego's route."""
EGO_CAMERAS, ELEVATED_CAMERAS = 56, 43

ABOVE = (-10.5, -8.5)
"""Place over which the bird's-eye hangs."""


@dataclass(frozen=True)
class TwoLaneMergeConfig:
    """Settings of the two-lane merge."""

    ego_start: float = 7.0
    """Arc length of the ego's centre at step 0 on its route, metres; the bend into the main lane is at 26."""
    ego_step: float = 8.0
    """Metres that the ego advances in a step."""
    lead_start: float = -13.5
    """x of the lead car's centre at step 0, metres."""
    lead_step: float = 11.5
    """Metres that the lead car advances in a step."""
    second_start: float = -31.0
    """x of the second car's centre at step 0, metres."""
    fast_step: float = 11.4
    """Metres that the second car advances in a step in branch 'fast'."""
    slow_step: float = 3.8
    """The same in branch 'slow'; both steps keep all its boxes apart."""
    step_seconds: float = 1.0
    """Seconds from one step to the next, for driving in closed loop."""
    jitter: float = 1.0
    """How far the seed may move sizes, plants and the parked lorry: 0 (not at all) to 1."""
    light: Light = field(default_factory=Light)
    """The sun."""
    ego_camera: EgoCameraConfig = field(default_factory=lambda: EgoCameraConfig(yaw=45.0, pan=20.0))
    """The camera that the ego carries: it looks over the left shoulder."""
    splits: SplitConfig = field(default_factory=SplitConfig)
    """Which cameras are held out."""

    def __post_init__(self) -> None:
        check_between("ego_start", self.ego_start, 5.5, 7.3)
        check_between("ego_step", self.ego_step, EGO_SIZE[0] + 2 * CLEARANCE + 1.0, 8.0)
        check_between("lead_start", self.lead_start, -14.5, -12.5)
        check_between("lead_step", self.lead_step, 11.0, 12.0)
        check_between("second_start", self.second_start, -33.0, -30.0)
        check_between("fast_step", self.fast_step, 11.2, 12.0)
        check_between("slow_step", self.slow_step, 3.7, 3.8)
        check_between("step_seconds", self.step_seconds, 0.1, 10.0)
        check_between("jitter", self.jitter, 0.0, 1.0)


def build_two_lane_merge(config: TwoLaneMergeConfig, seed: int) -> World:
    """The world of one (config, seed)."""
    layout, rig_noise, actor_noise = (np.random.default_rng([seed, stream]) for stream in range(3))
    actors = _actors(config.jitter, actor_noise)
    ego, lane = ego_route(), straight((AREA[0], 0.0), 0.0, AREA[2] - AREA[0])
    states = tuple(_state(config, ego, branch, step) for branch in (0, 1) for step in range(STEPS))
    camera = config.ego_camera
    mount = Mount(camera.height, -3.0, camera.yaw, camera.pan, LINE - 8.4, LINE - 0.4, camera.field_of_view)
    return World(
        scenario="two_lane_merge",
        seed=seed,
        config=config,
        branches=("fast", "slow"),
        static=tuple(street_bodies(layout, config.jitter)),
        actors=actors,
        states=states,
        light=config.light,
        scene_box=SCENE_BOX,
        rig=_rig(config, ego, mount, rig_noise),
        mount=mount,
        traffic=nominal_traffic(
            {"ego": ego, "lead": lane, "second": lane},
            {name: actor.size for name, actor in actors.items()},
            [(state.branch, state.step, state.poses) for state in states],
            LINE - EGO_SIZE[0] / 2,
            config.step_seconds,
        ),
    )


def _actors(jitter: float, rng: np.random.Generator) -> dict[str, Actor]:
    """The seed shades the lead car's paint; sizes are fixed, since the second car's boxes lie end to end."""
    shade = 1.0 - 0.2 * jitter * float(rng.uniform())
    return {
        "ego": Actor(sedan(EGO_SIZE, (0.03, 0.10, 0.50)), EGO_SIZE),
        "lead": Actor(sedan(LEAD_SIZE, (0.75 * shade, 0.55 * shade, 0.04)), LEAD_SIZE),
        "second": Actor(sedan(SECOND_SIZE, (0.75, 0.13, 0.03)), SECOND_SIZE),
    }


def _state(config: TwoLaneMergeConfig, ego: Route, branch: int, step: int) -> State:
    advance = config.fast_step if branch == 0 else config.slow_step
    poses = {
        "ego": ego.pose(config.ego_start + config.ego_step * step),
        "lead": Pose(config.lead_start + config.lead_step * step, 0.0, 0.0, 0.0),
        "second": Pose(config.second_start + advance * step, 0.0, 0.0, 0.0),
    }
    return State(branch, step, branch == 0, poses)


def _rig(config: TwoLaneMergeConfig, ego: Route, mount: Mount, rng: np.random.Generator) -> Rig:
    """56 cameras on the ego's lane, 43 on a ring, one bird's-eye."""
    bodies = [config.ego_start + config.ego_step * step for step in range(STEPS)]
    poses = lane_poses(ego, bodies, EGO_SIZE, (0.5, LINE + 0.8), EGO_CAMERAS, mount, rng)
    # the ring stands around what the bird's-eye sees
    poses += ring_poses(ELEVATED_CAMERAS, ABOVE, (*ABOVE, 0.5), (21.0, 31.0), (13.0, 22.0), rng)
    poses.append(look_at((*ABOVE, 47.0), (*ABOVE, 0.0), (0.0, 1.0, 0.0)))
    kinds = ("ego",) * EGO_CAMERAS + ("elevated",) * ELEVATED_CAMERAS + ("birds_eye",)
    fields = [mount.field_of_view] * EGO_CAMERAS + [72.0] * ELEVATED_CAMERAS + [56.0]
    splits = interleaved_splits(kinds, config.splits.test_every, config.splits.birds_eye)
    return Rig(pinholes(poses, fields), kinds, splits)
