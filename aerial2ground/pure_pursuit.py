"""Steering by pure pursuit and a speed that yields to obstacles (III-C; Coulter 1992).

The car's pose is that of its rear axle. A point a fixed distance ahead on the path, at (x, y) in the car's frame and at
distance d, is reached on a circle of curvature 2 y / d^2; a wheelbase L steers it with atan(L * curvature). Radians,
positive to the left.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from aerial2ground.paths import Path
from hashnerf.errors import UserError


@dataclass(frozen=True)
class PurePursuitConfig:
    """The expert driver; the car is the F1TENTH one."""

    look_ahead: float = 0.55
    """Metres along the path from the place nearest to the rear axle to the point that is steered for."""
    wheelbase: float = 0.33
    """Metres between the axles."""
    steering_limit: float = 0.4189
    """Largest steering angle, radians."""
    low_pass: float = 0.5
    """Share of a new command in the next steering angle; the rest is the last one."""
    speed: float = 0.8
    """Nominal speed, m/s."""
    slow_speed: float = 0.3
    """Speed close to an obstacle, m/s."""
    slow_distance: float = 0.8
    """Metres to an obstacle ahead from which the car slows down; at half of it the slow speed is reached."""
    corridor: float = 0.3
    """Obstacles closer to the path than this count, metres."""

    def __post_init__(self):
        for key in ("look_ahead", "wheelbase", "speed", "slow_speed", "slow_distance", "corridor"):
            if not 0 < getattr(self, key) < math.inf:
                raise UserError(f"pure_pursuit.{key} is {getattr(self, key)}; give a positive number")
        if not 0 < self.steering_limit < math.pi / 2:
            raise UserError(f"pure_pursuit.steering_limit is {self.steering_limit}; give radians below pi / 2")
        if not 0 < self.low_pass <= 1:
            raise UserError(f"pure_pursuit.low_pass is {self.low_pass}; give a number above 0 and up to 1")
        if self.slow_speed > self.speed:
            raise UserError(f"pure_pursuit.slow_speed is {self.slow_speed}, faster than speed = {self.speed}")


def require_followable(path: Path, config: PurePursuitConfig) -> None:
    """Raises UserError for a path that is shorter than the look-ahead."""
    if path.length <= config.look_ahead:
        raise UserError(
            f"the path is {path.length:.2f} m long, shorter than pure_pursuit.look_ahead = {config.look_ahead} m; "
            "give a longer path or a shorter look-ahead"
        )


def steering(path: Path, pose: Float[np.ndarray, " 3"], config: PurePursuitConfig) -> float:
    """Returns the steering angle of a car at (x, y, yaw); raises UserError for a pose that is not finite.

    Where the point lies behind, the car turns as tightly as it can: a circle through a point straight behind would be a
    straight line that leads away from it.
    """
    if not np.isfinite(pose).all():
        raise UserError(f"the car's pose {pose.tolist()} is not finite; stop the car")
    s, _ = path.nearest(pose[:2])
    target = path.at(np.array([s + config.look_ahead]))[0]
    offset = target - pose[:2]
    ahead = math.cos(pose[2]) * offset[0] + math.sin(pose[2]) * offset[1]
    left = -math.sin(pose[2]) * offset[0] + math.cos(pose[2]) * offset[1]
    if ahead < 0:
        return math.copysign(config.steering_limit, left)
    square = float(offset @ offset)
    curvature = 2 * left / square if square > 1e-9 else 0.0
    angle = math.atan(config.wheelbase * curvature)
    return float(np.clip(angle, -config.steering_limit, config.steering_limit))


def near_path(path: Path, obstacles: Float[np.ndarray, "n 2"], config: PurePursuitConfig) -> Float[np.ndarray, " near"]:
    """Returns the arc lengths at which an obstacle stands closer to the path than the corridor."""
    places = [path.nearest(obstacle) for obstacle in obstacles]
    return np.array([place for place, aside in places if abs(aside) <= config.corridor])


def speed(path: Path, pose: Float[np.ndarray, " 3"], near: Float[np.ndarray, " n"], config: PurePursuitConfig) -> float:
    """Returns the speed: nominal, and less the closer ahead on the path the next of the arc lengths `near` is.

    At the end of an open path it is 0: there is nothing left to steer for.
    """
    place = path.nearest(pose[:2])[0]
    if not path.closed and place >= path.length - 1e-6:
        return 0.0
    ahead = near - place
    ahead = np.mod(ahead, path.length) if path.closed else ahead[ahead >= 0]
    gap = float(ahead.min()) if len(ahead) else math.inf
    share = (gap - config.slow_distance / 2) / (config.slow_distance / 2)
    return config.slow_speed + (config.speed - config.slow_speed) * min(max(share, 0.0), 1.0)


class LowPass:
    """y <- (1 - share) y + share x; the first value passes as it is."""

    def __init__(self, share: float):
        self.share = share
        self.value: float | None = None

    def __call__(self, value: float, share: float | None = None) -> float:
        """Takes in a command, by another share where one is given; returns the filtered one.

        Raises UserError for a command that is not finite and forgets it: one would stay in the average for good.
        """
        if not math.isfinite(value):
            raise UserError(f"the command {value} is no steering angle; stop the car")
        share = self.share if share is None else share
        self.value = value if self.value is None else (1 - share) * self.value + share * value
        return self.value


def share_after(seconds: float, time_constant: float) -> float:
    """Returns the share that a low-pass of this time constant (s) gives a command `seconds` after the last one.

    Half each 0.1 s is a time constant of 0.1 / ln 2 = 0.144 s. Without a time constant (0) nothing is smoothed.
    """
    return -math.expm1(-max(seconds, 0.0) / time_constant) if time_constant > 0 else 1.0
