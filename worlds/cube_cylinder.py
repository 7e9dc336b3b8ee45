"""Cube and cylinder (CARFF Fig. 5): a blue cube that stands still hides a red cylinder, which may be absent and moves
left or right. Branches 'absent', 'left', 'right'; two steps; 'left' and 'right' share their first state.
"""

from dataclasses import dataclass, field

import numpy as np

from hashnerf.cameras import look_at
from worlds.boxes import Pose
from worlds.checks import check_between
from worlds.meshes import Material, block, cylinder
from worlds.rig import interleaved_splits, pinholes, ring_poses
from worlds.scene import Actor, Rig, State, World
from worlds.settings import SplitConfig
from worlds.shading import Light

BRANCHES = ("absent", "left", "right")
WEIGHTS = (0.5, 0.25, 0.25)
"""The cylinder is there or not, and goes left or right, with equal chance."""
AREA = (-9.0, -9.0, 9.0, 9.0)
SCENE_BOX = np.array([[-9.0, -9.0, -0.3], [9.0, 9.0, 3.0]])
CUBE, RADIUS, HEIGHT = 2.0, 0.6, 1.7
LOW_CAMERAS, HIGH_CAMERAS = 56, 43
PLANE = Material((0.27, 0.27, 0.25), grain=0.10)


@dataclass(frozen=True)
class CubeCylinderConfig:
    """Settings of the cube and cylinder."""

    distance: float = 2.4
    """Metres from the cube's centre back to the cylinder's."""
    move: float = 2.2
    """Metres that the cylinder moves to the left or to the right."""
    jitter: float = 1.0
    """How far the seed may move the cylinder's middle position: 0 (not at all) to 1."""
    light: Light = field(default_factory=lambda: Light(azimuth=240.0, elevation=55.0))
    """The sun."""
    splits: SplitConfig = field(default_factory=SplitConfig)
    """Which cameras are held out."""

    def __post_init__(self) -> None:
        check_between("distance", self.distance, 2.0, 4.0)
        check_between("move", self.move, 1.5, 4.0)
        check_between("jitter", self.jitter, 0.0, 1.0)


def build_cube_cylinder(config: CubeCylinderConfig, seed: int) -> World:
    """The world of one (config, seed)."""
    layout, rig_noise = (np.random.default_rng([seed, stream]) for stream in range(2))
    middle = 0.1 * config.jitter * float(layout.uniform(-1.0, 1.0))
    blue, red = Material((0.03, 0.10, 0.50), gloss=0.03), Material((0.60, 0.04, 0.03), gloss=0.03)
    x0, y0, x1, y1 = AREA
    size = (2 * RADIUS, 2 * RADIUS, HEIGHT)
    states = []
    for branch, name in enumerate(BRANCHES):
        for step in (0, 1):
            x = middle + step * {"absent": 0.0, "left": -config.move, "right": config.move}[name]
            poses = {"ego": Pose(0.0, 0.0, 0.0, 0.0)}
            if name != "absent":
                poses["cylinder"] = Pose(x, config.distance, 0.0, 0.0)
            states.append(State(branch, step, name != "absent", poses))
    return World(
        scenario="cube_cylinder",
        seed=seed,
        config=config,
        branches=BRANCHES,
        branch_weights=WEIGHTS,
        static=(("plane", block((x0, y0, -0.2), (x1, y1, 0.0), PLANE)),),
        actors={
            "ego": Actor(block((-CUBE / 2, -CUBE / 2, 0.0), (CUBE / 2, CUBE / 2, CUBE), blue), (CUBE, CUBE, CUBE)),
            "cylinder": Actor(cylinder((0.0, 0.0, HEIGHT / 2), RADIUS, HEIGHT, red, sides=32), size),
        },
        states=tuple(states),
        light=config.light,
        scene_box=SCENE_BOX,
        rig=_rig(config, rig_noise),
    )


def _rig(config: CubeCylinderConfig, rng: np.random.Generator) -> Rig:
    """Half a ring in front: low cameras (from some the cube hides the cylinder), high ones, one from above."""
    target = (0.0, 1.0, 0.8)
    low = ring_poses(LOW_CAMERAS, (0.0, 0.5), target, (7.0, 8.5), (0.9, 1.6), rng, (190.0, 350.0))
    high = ring_poses(HIGH_CAMERAS, (0.0, 0.5), target, (6.5, 8.5), (3.0, 6.0), rng, (180.0, 360.0))
    above = look_at((0.0, 1.2, 14.0), (0.0, 1.2, 0.0), (0.0, 1.0, 0.0))
    kinds = ("ego",) * LOW_CAMERAS + ("elevated",) * HIGH_CAMERAS + ("birds_eye",)
    fields = [55.0] * (LOW_CAMERAS + HIGH_CAMERAS) + [45.0]
    splits = interleaved_splits(kinds, config.splits.test_every, config.splits.birds_eye)
    return Rig(pinholes([*low, *high, above], fields), kinds, splits)
