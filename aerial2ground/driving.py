"""Driving in closed loop (IV-D): a policy sees the car's camera, steers, and is put back where it strays.

An *intervention* is a lateral error over `intervention` metres, or a body touched; the car is then put back on the path
at the nearest place and drives on. Errors are those of the rear axle against the path: lateral distance in metres,
heading in radians; root mean squares over all moments.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, UInt8

from aerial2ground.car import CarConfig, CarState, advance, footprint
from aerial2ground.ground_poses import shifted
from aerial2ground.paths import Path
from aerial2ground.pure_pursuit import LowPass, PurePursuitConfig, near_path, speed
from hashnerf.errors import UserError

Look = Callable[[CarState], UInt8[np.ndarray, "h w c"]]
Policy = Callable[[UInt8[np.ndarray, "h w c"], CarState], float]
Touches = Callable[[Float[np.ndarray, "4 2"]], bool]


@dataclass(frozen=True)
class DriveConfig:
    """How a policy is tried."""

    laps: int = 2
    """Laps of a closed path."""
    tick: float = 0.1
    """Seconds between pictures, and commands."""
    motion_ticks: int = 4
    """Steps of the car's motion per command."""
    start_lateral: float = 0.06
    """Largest distance of the start from the path, metres."""
    start_heading: float = 8.0
    """Largest error of the first heading, degrees."""
    intervention: float = 0.175
    """Lateral error at which somebody intervenes: half a lane, metres; .inf: only where a body is touched."""

    def __post_init__(self):
        for key in ("laps", "motion_ticks"):
            if getattr(self, key) < 1:
                raise UserError(f"drive.{key} is {getattr(self, key)}; give at least 1")
        if not 0 < self.tick < math.inf:
            raise UserError(f"drive.tick is {self.tick}; give a positive number")
        if not self.intervention > 0:
            raise UserError(f"drive.intervention is {self.intervention}; give a positive number")
        for key in ("start_lateral", "start_heading"):
            if not 0 <= getattr(self, key) < math.inf:
                raise UserError(f"drive.{key} is {getattr(self, key)}; give 0 or a positive number")


@dataclass(frozen=True)
class Drive:
    """What happened."""

    lateral: Float[np.ndarray, " moments"]
    heading: Float[np.ndarray, " moments"]
    track: Float[np.ndarray, "moments 2"]
    motion: Float[np.ndarray, "motions 4"]
    """Time (s) and pose (x, y, yaw) of the rear axle, `motion_ticks` of them per moment, from the start on."""
    put_back: Float[np.ndarray, "interventions 2"]
    """Where somebody intervened."""
    put_back_at: Int[np.ndarray, " interventions"]
    """After which moments: `motion` jumps there, as nothing that drives can."""

    @property
    def unbroken(self) -> int:
        """Moments until the car was first lifted and put back; all of them where it never was."""
        return int(self.put_back_at[0]) + 1 if self.interventions else len(self.lateral)

    @property
    def interventions(self) -> int:
        """How often somebody intervened."""
        return len(self.put_back)

    @property
    def position_rmse(self) -> float:
        """Metres."""
        return float(np.sqrt(np.mean(self.lateral**2)))

    @property
    def yaw_rmse(self) -> float:
        """Degrees."""
        return float(np.degrees(np.sqrt(np.mean(self.heading**2))))


def drive(
    policy: Policy,
    look: Look,
    touches: Touches,
    obstacles: Float[np.ndarray, "n 2"],
    path: Path,
    config: DriveConfig,
    car: CarConfig,
    pursuit: PurePursuitConfig,
    rng: np.random.Generator,
) -> Drive:
    """Drives `config.laps` laps from a disturbed start; `look` renders what the camera sees.

    The speed is not the policy's: it is nominal, and less near `obstacles` (x, y) ahead (III-C).
    """
    state = disturbed_start(path, config, pursuit, rng)
    smooth = LowPass(pursuit.low_pass)
    lateral, heading, track, put_back, put_back_at = [], [], [], [], []
    step = config.tick / config.motion_ticks
    motion = [(0.0, *state.pose)]
    travelled, last = 0.0, path.nearest(state.pose[:2])[0]
    near = near_path(path, obstacles, pursuit)
    longest = int(3 * config.laps * path.length / (pursuit.slow_speed * config.tick)) + 1
    for _ in range(longest):
        command, pace = smooth(policy(look(state), state)), speed(path, state.pose, near, pursuit)
        for _ in range(config.motion_ticks):
            state = advance(state, command, pace, step, car)
            motion.append((len(motion) * step, *state.pose))
        s, left = path.nearest(state.pose[:2])
        error = math.remainder(state.yaw - float(path.poses(np.array([s]))[0, 2]), 2 * math.pi)
        lateral.append(abs(left))
        heading.append(error)
        track.append((state.x, state.y))
        travelled += math.remainder(s - last, path.length) if path.closed else s - last
        last = s
        if abs(left) > config.intervention or touches(footprint(state.pose, car)):
            put_back.append((state.x, state.y))
            put_back_at.append(len(lateral) - 1)
            x, y, yaw = path.poses(np.array([s]))[0]
            state = CarState(float(x), float(y), float(yaw), state.speed)
            smooth = LowPass(pursuit.low_pass)
        if travelled >= config.laps * path.length - 1e-6 or (not path.closed and s >= path.length - 0.02):
            break
    return Drive(
        np.array(lateral),
        np.array(heading),
        np.array(track),
        np.array(motion),
        np.array(put_back).reshape(-1, 2),
        np.array(put_back_at, dtype=int),
    )


def disturbed_start(path: Path, config: DriveConfig, pursuit: PurePursuitConfig, rng: np.random.Generator) -> CarState:
    """Returns a state somewhere on a closed path, or at the start of an open one, off it as configured."""
    place = rng.uniform(0, path.length) if path.closed else 0.0
    aside = rng.uniform(-1, 1, 1) * config.start_lateral
    turn = np.radians(rng.uniform(-1, 1, 1) * config.start_heading)
    x, y, yaw = shifted(path.poses(np.array([place])), aside, turn)[0]
    return replace(CarState(float(x), float(y), float(yaw)), speed=pursuit.speed)
