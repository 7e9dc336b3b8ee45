"""What the car's inertial sensor tells while it drives a known track: yaw rate, and acceleration in the car's frame.

The sensor stands above the rear axle and is level: gravity is taken off, and what a small tilt leaves of it counts as
bias. A reading is the mean over the time since the one before: readings times time add up to the turn and to the change
of speed. Seconds, metres, radians; forward is the car's x, left its y.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hashnerf.errors import UserError
from worlds.checks import check_between


@dataclass(frozen=True)
class InertialConfig:
    """The sensor; all noises, biases and the drift at zero make it perfect.

    The defaults are of the order that data sheets of consumer MEMS sensors, such as the one in a ZED 2i camera, give:
    0.01 degrees per second and 0.3 mg per root hertz (times the root of half the rate), and zero offsets that a
    calibration at standstill has brought down to half a degree per second and 5 mg, a tilt of 0.3 degrees.
    """

    rate: float = 100.0
    """Readings per second."""
    gyro_noise: float = 0.0012
    """Standard deviation of one yaw rate, rad/s."""
    gyro_bias: float = 0.01
    """Standard deviation of the yaw rate's constant error, drawn at the start, rad/s."""
    gyro_drift: float = 0.0002
    """Random walk of the yaw rate's error, rad/s per root second."""
    accel_noise: float = 0.02
    """Standard deviation of one acceleration, m/s^2."""
    accel_bias: float = 0.05
    """Standard deviation of the accelerations' constant errors, drawn at the start, m/s^2."""

    def __post_init__(self) -> None:
        check_between("inertial.rate", self.rate, 1.0, 10000.0)
        check_between("inertial.gyro_noise", self.gyro_noise, 0.0, 1.0)
        check_between("inertial.gyro_bias", self.gyro_bias, 0.0, 1.0)
        check_between("inertial.gyro_drift", self.gyro_drift, 0.0, 1.0)
        check_between("inertial.accel_noise", self.accel_noise, 0.0, 10.0)
        check_between("inertial.accel_bias", self.accel_bias, 0.0, 10.0)


@dataclass(frozen=True)
class Readings:
    """Readings in the order of their times; each is the mean over the time since the one before."""

    time: Float[np.ndarray, " n"]
    """Seconds, on the clock of the track."""
    yaw_rate: Float[np.ndarray, " n"]
    """Counter-clockwise from above, rad/s."""
    acceleration: Float[np.ndarray, "n 2"]
    """Forward and left, m/s^2."""


def measure(
    time: Float[np.ndarray, " m"],
    poses: Float[np.ndarray, "m 3"],
    config: InertialConfig,
    rng: np.random.Generator,
) -> Readings:
    """Returns the readings of a car whose rear axle is at `poses` (x, y, yaw; metres, radians) at times `time` (s).

    The first reading ends 1 / rate after the start. The track must be dense: the car turns less than half a turn from
    one pose to the next. Constant yaw rates and constant accelerations are met exactly. Raises UserError for a track
    of fewer than three poses or shorter than one reading, with times that do not rise, or with numbers not finite.
    """
    _require_track(time, poses, config)
    count = int((time[-1] - time[0]) * config.rate + 1e-6)
    ends = np.minimum(time[0] + np.arange(count + 1) / config.rate, time[-1])
    yaw = np.interp(ends, time, np.unwrap(poses[:, 2]))
    # of second order at the ends too, and so exact for constant acceleration
    velocity = np.gradient(poses[:, :2], time, axis=0, edge_order=2)
    velocity = np.stack([np.interp(ends, time, velocity[:, axis]) for axis in range(2)], axis=1)
    yaw_rate = np.diff(yaw) * config.rate
    middle = (yaw[:-1] + yaw[1:]) / 2
    change = np.diff(velocity, axis=0) * config.rate
    forward = np.cos(middle) * change[:, 0] + np.sin(middle) * change[:, 1]
    left = np.cos(middle) * change[:, 1] - np.sin(middle) * change[:, 0]

    wander = np.cumsum(rng.standard_normal(count)) * config.gyro_drift / np.sqrt(config.rate)
    yaw_rate = yaw_rate + config.gyro_bias * rng.standard_normal() + wander
    yaw_rate = yaw_rate + config.gyro_noise * rng.standard_normal(count)
    acceleration = np.stack([forward, left], axis=1) + config.accel_bias * rng.standard_normal(2)
    acceleration = acceleration + config.accel_noise * rng.standard_normal((count, 2))
    return Readings(ends[1:], yaw_rate, acceleration)


def _require_track(time: np.ndarray, poses: np.ndarray, config: InertialConfig) -> None:
    if not (np.isfinite(time).all() and np.isfinite(poses).all()):
        raise UserError("the track holds a time or a pose that is not finite")
    if len(time) < 3:
        raise UserError(f"the track has {len(time)} poses; give at least 3")
    if not (np.diff(time) > 0).all():
        raise UserError("the times of the track do not rise from pose to pose")
    if (time[-1] - time[0]) * config.rate < 1 - 1e-6:
        raise UserError(
            f"the track lasts {time[-1] - time[0]:.4g} s, less than one reading at inertial.rate = {config.rate} Hz"
        )
