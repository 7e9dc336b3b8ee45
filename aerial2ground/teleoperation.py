"""Pictures collected by a person who drives the town as it is now (IV-C, IV-D): what the paper's baselines learn from.

The person follows a path by pure pursuit with an unsteady hand: an error of steering that comes and goes. What is kept
is the steering that the expert would have chosen at the pose where each picture was taken.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, UInt8

from aerial2ground.car import CarState
from aerial2ground.paths import Path
from aerial2ground.pure_pursuit import PurePursuitConfig, steering
from hashnerf.errors import UserError


@dataclass(frozen=True)
class TeleoperationConfig:
    """How a person drives."""

    laps: int = 3
    """Laps of every trajectory."""
    hand: float = 0.06
    """Standard deviation of the driver's error of steering, radians."""
    hand_seconds: float = 0.7
    """About how long such an error lasts."""
    field_steps: int = 300
    """Training steps of the radiance field of the collected pictures."""
    views: int = 200
    """Views per trajectory of that field."""

    def __post_init__(self):
        for key in ("laps", "field_steps", "views"):
            if getattr(self, key) < 1:
                raise UserError(f"teleoperation.{key} is {getattr(self, key)}; give at least 1")
        if not 0 <= self.hand < math.pi / 2:
            raise UserError(f"teleoperation.hand is {self.hand}; give radians from 0 to below pi / 2")
        if not 0 < self.hand_seconds < math.inf:
            raise UserError(f"teleoperation.hand_seconds is {self.hand_seconds}; give a positive number")


@dataclass
class Teleoperator:
    """A policy that steers by what it knows of the path, and remembers what the camera saw."""

    path: Path
    pursuit: PurePursuitConfig
    config: TeleoperationConfig
    tick: float
    rng: np.random.Generator
    pictures: list[UInt8[np.ndarray, "h w c"]] = field(default_factory=list)
    poses: list[Float[np.ndarray, " 3"]] = field(default_factory=list)
    wanted: list[float] = field(default_factory=list)
    _error: float = 0.0

    def __call__(self, picture: UInt8[np.ndarray, "h w c"], state: CarState) -> float:
        """Keeps the picture, the pose and the expert's steering; returns the person's."""
        wanted = steering(self.path, state.pose, self.pursuit)
        self.pictures.append(picture)
        self.poses.append(state.pose)
        self.wanted.append(wanted)
        # a first-order process with the standard deviation asked for, whatever the tick
        stay = math.exp(-self.tick / self.config.hand_seconds)
        kick = self.config.hand * math.sqrt(1 - stay**2)
        self._error = stay * self._error + kick * float(self.rng.standard_normal())
        return wanted + self._error
