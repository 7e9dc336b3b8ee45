"""A drone's survey of the mini-city: nadir pictures in rows, oblique ones around, one lens, and poses with noise.

The pictures are taken from the true poses; what the data set tells is where the drone believed to be.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from kornia.geometry.conversions import axis_angle_to_rotation_matrix
from torch import Tensor

from hashnerf.cameras import Cameras, look_at
from worlds.checks import check_between
from worlds.mini_city_roads import AREA
from worlds.rig import CameraPose, interleaved_splits
from worlds.scene import Rig

WIDTH, HEIGHT = 240, 180
"""Pixels of the rig's cameras; `Cameras.scaled` changes them exactly."""
OUTSIDE = 2.0
"""Metres beyond the town's edge that the drone flies at most, where a place can be seen from there as flatly as asked.

From farther off, badly told poses cannot be mended (docs/results/aerial2ground_notes.md)."""


@dataclass(frozen=True)
class SurveyConfig:
    """How the drone flies and how well it knows where it is."""

    images: int = 100
    """Pictures in all."""
    oblique_share: float = 0.7
    """Share of the pictures that look ahead and down; the others look straight down."""
    steepest: float = 45.0
    """Largest angle of an oblique picture below the horizon, degrees."""
    flattest: float = 15.0
    """Smallest angle of an oblique picture below the horizon, degrees."""
    field_of_view: float = 68.0
    """Degrees across."""
    nadir_height: float = 2.4
    """Metres above the road of the pictures that look down."""
    oblique_height: float = 1.5
    """Metres above the road of the pictures that look ahead and down."""
    k1: float = -0.08
    """First radial coefficient of the lens."""
    k2: float = 0.012
    """Second radial coefficient of the lens."""
    position_noise: float = 0.003
    """Standard deviation of each told coordinate, metres (motion capture; a good GPS would be 0.03 at this scale)."""
    angle_noise: float = 0.2
    """Standard deviation of the told orientation about each axis, degrees."""
    test_every: int = 8
    """Every how many pictures of a kind one is held out."""

    def __post_init__(self) -> None:
        check_between("survey.images", self.images, 8, 2000)
        check_between("survey.oblique_share", self.oblique_share, 0.0, 1.0)
        check_between("survey.flattest", self.flattest, 10.0, 80.0)
        check_between("survey.steepest", self.steepest, self.flattest, 85.0)
        check_between("survey.field_of_view", self.field_of_view, 30.0, 100.0)
        check_between("survey.nadir_height", self.nadir_height, 1.0, 6.0)
        check_between("survey.oblique_height", self.oblique_height, 0.9, 6.0)
        check_between("survey.k1", self.k1, -0.2, 0.2)
        check_between("survey.k2", self.k2, -0.05, 0.05)
        check_between("survey.position_noise", self.position_noise, 0.0, 0.2)
        check_between("survey.angle_noise", self.angle_noise, 0.0, 10.0)
        check_between("survey.test_every", self.test_every, 3, 50)


def survey_rig(config: SurveyConfig, rng: np.random.Generator) -> Rig:
    """The survey's cameras, and where the drone believed them to be."""
    down = config.images - round(config.oblique_share * config.images)
    poses = _nadir(config, down, rng) + _oblique(config, config.images - down, rng)
    kinds = ("nadir",) * down + ("oblique",) * (config.images - down)
    focal = 0.5 * WIDTH / math.tan(math.radians(config.field_of_view) / 2)
    count = len(poses)
    lens = torch.tensor([[config.k1, config.k2, 0.0, 0.0]]).repeat(count, 1)
    centre = torch.tensor([[WIDTH / 2, HEIGHT / 2]]).repeat(count, 1)
    cameras = Cameras(torch.stack(poses), torch.full((count, 2), focal), centre, lens, WIDTH, HEIGHT)
    told = torch.stack([disturbed(pose, config.position_noise, config.angle_noise, rng) for pose in poses])
    return Rig(cameras, kinds, interleaved_splits(kinds, config.test_every, "train"), told)


def disturbed(
    pose: CameraPose, position_noise: float, angle_noise: float, rng: np.random.Generator
) -> Float[Tensor, "4 4"]:
    """The pose moved by Gaussian noise (metres) and turned about its own axes (degrees), still rigid."""
    vector = torch.from_numpy(np.radians(angle_noise) * rng.standard_normal(3))
    turn = axis_angle_to_rotation_matrix(vector[None])[0]
    result = pose.double().clone()
    result[:3, :3] = result[:3, :3] @ turn
    result[:3, 3] += torch.from_numpy(position_noise * rng.standard_normal(3))
    return result.float()


def _nadir(config: SurveyConfig, count: int, rng: np.random.Generator) -> list[CameraPose]:
    """Rows over the town, there and back, the camera nearly straight down."""
    x0, y0, x1, y1 = AREA
    rows = max(round(math.sqrt(count * (y1 - y0) / (x1 - x0))), 1)
    poses = []
    for number in range(count):
        row, place = divmod(number * rows, count)
        share = place / count
        share = share if row % 2 == 0 else 1 - share
        x = x0 + 0.3 + (x1 - x0 - 0.6) * share + rng.uniform(-0.08, 0.08)
        y = y0 + 0.3 + (y1 - y0 - 0.6) * (row + 0.5) / rows + rng.uniform(-0.08, 0.08)
        eye = (x, y, config.nadir_height * rng.uniform(0.94, 1.06))
        target = (x + rng.uniform(-0.15, 0.15), y + rng.uniform(-0.15, 0.15), 0.0)
        poses.append(look_at(eye, target, (0.0, 1.0 if row % 2 == 0 else -1.0, 0.0)))
    return poses


def _oblique(config: SurveyConfig, count: int, rng: np.random.Generator) -> list[CameraPose]:
    """Pictures of places all over the town; headings are spread evenly, but for those from too far outside."""
    x0, y0, x1, y1 = AREA
    poses = []
    for number in range(count):
        height = config.oblique_height * rng.uniform(0.85, 1.15)
        reach = height / math.tan(math.radians(rng.uniform(config.flattest, config.steepest)))
        share = np.array([(number + 0.5) / count, (number * 0.7548777) % 1.0])
        target = np.array([x0, y0]) + share[::-1] * np.array([x1 - x0, y1 - y0])
        turns = number * 0.618034 + np.arange(16) / 16
        eyes = target - reach * np.stack([np.cos(2 * math.pi * turns), np.sin(2 * math.pi * turns)], axis=1)
        beyond = np.maximum(np.array([x0, y0]) - eyes, eyes - np.array([x1, y1])).max(axis=1)
        eye = eyes[int(np.argmax(beyond <= max(OUTSIDE, beyond.min())))]
        poses.append(look_at((*eye.tolist(), height), (*target.tolist(), 0.0)))
    return poses
