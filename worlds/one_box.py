"""One box in the air, or nothing at all: how little a scene can hold. One state, cameras all around it."""

from dataclasses import dataclass, field

import numpy as np

from worlds.checks import check_between
from worlds.meshes import Material, block
from worlds.rig import interleaved_splits, pinholes, ring_poses
from worlds.scene import Rig, State, World
from worlds.settings import SplitConfig
from worlds.shading import Light

SCENE_BOX = np.array([[-2.0, -2.0, -2.0], [2.0, 2.0, 2.0]])
SIDE = 1.0
CAMERAS = 64
MATERIAL = Material((0.60, 0.30, 0.05), grain=0.3, gloss=0.03)


@dataclass(frozen=True)
class OneBoxConfig:
    """Settings of the box in the air."""

    boxes: int = 1
    """1, or 0 for an empty sky."""
    light: Light = field(default_factory=lambda: Light(azimuth=240.0, elevation=55.0))
    """The sun."""
    splits: SplitConfig = field(default_factory=SplitConfig)
    """Which cameras are held out."""

    def __post_init__(self) -> None:
        check_between("boxes", self.boxes, 0, 1)


def build_one_box(config: OneBoxConfig, seed: int) -> World:
    """The world of one (config, seed)."""
    half = SIDE / 2
    body = ("box", block((-half, -half, -half), (half, half, half), MATERIAL))
    return World(
        scenario="one_box",
        seed=seed,
        config=config,
        branches=("only",),
        static=(body,) * config.boxes,
        actors={},
        states=(State(0, 0, False, {}),),
        light=config.light,
        scene_box=SCENE_BOX,
        rig=_rig(config, np.random.default_rng([seed, 0])),
    )


def _rig(config: OneBoxConfig, rng: np.random.Generator) -> Rig:
    """A ring all around, from below the box to above it."""
    poses = ring_poses(CAMERAS, (0.0, 0.0), (0.0, 0.0, 0.0), (3.0, 4.0), (-1.5, 3.0), rng, (0.0, 360.0))
    kinds = ("elevated",) * CAMERAS
    return Rig(pinholes(poses, [50.0] * CAMERAS), kinds, interleaved_splits(kinds, config.splits.test_every, "test"))
