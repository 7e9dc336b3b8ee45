"""The car as a kinematic bicycle: rear axle at (x, y), heading yaw, steering angle and speed (metres, radians)."""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from hashnerf.errors import UserError


@dataclass(frozen=True)
class CarConfig:
    """The car's body and what its actuators can do."""

    wheelbase: float = 0.33
    """Metres between the axles."""
    length: float = 0.5
    """Metres from bumper to bumper; the rear axle lies a fifth of it ahead of the rear one."""
    width: float = 0.28
    """Metres."""
    steering_limit: float = 0.4189
    """Largest steering angle, radians."""
    steering_rate: float = 3.2
    """Fastest change of the steering angle, radians per second (F1TENTH)."""
    acceleration: float = 3.0
    """Fastest change of the speed, m/s^2."""

    def __post_init__(self):
        for key in ("wheelbase", "length", "width", "steering_limit", "steering_rate", "acceleration"):
            if not 0 < getattr(self, key) < math.inf:
                raise UserError(f"car.{key} is {getattr(self, key)}; give a positive number")


@dataclass(frozen=True)
class CarState:
    """One moment."""

    x: float
    y: float
    yaw: float
    speed: float = 0.0
    steering: float = 0.0

    @property
    def pose(self) -> Float[np.ndarray, " 3"]:
        """(x, y, yaw)."""
        return np.array([self.x, self.y, self.yaw])


def advance(state: CarState, steering: float, speed: float, seconds: float, config: CarConfig) -> CarState:
    """Returns the state after `seconds` of commanded steering angle and speed; the arc is exact."""
    wanted = min(max(steering, -config.steering_limit), config.steering_limit)
    turn, push = config.steering_rate * seconds, config.acceleration * seconds
    angle = state.steering + min(max(wanted - state.steering, -turn), turn)
    velocity = state.speed + min(max(speed - state.speed, -push), push)
    way = velocity * seconds
    change = way * math.tan(angle) / config.wheelbase
    # the chord of an arc of length `way`: sinc stays exact where the car goes straight on
    chord = way * float(np.sinc(change / (2 * math.pi)))
    heading = state.yaw + change / 2
    return replace(
        state,
        x=state.x + chord * math.cos(heading),
        y=state.y + chord * math.sin(heading),
        yaw=math.remainder(state.yaw + change, 2 * math.pi),
        speed=velocity,
        steering=angle,
    )


def footprint(pose: Float[np.ndarray, " 3"], config: CarConfig) -> Float[np.ndarray, "4 2"]:
    """Returns the corners of the car's body, counter-clockwise."""
    rear, front, half = -0.2 * config.length, 0.8 * config.length, config.width / 2
    corners = np.array([[front, half], [rear, half], [rear, -half], [front, -half]])
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    return corners @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]
