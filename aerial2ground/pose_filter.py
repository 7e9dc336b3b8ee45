"""The pose network's answers fused with the inertial sensor's by an extended Kalman filter ("Ours + IMU", IV-C).

The state is (x, y, yaw, speed, gyro bias, accelerometer bias): metres, radians, m/s, rad/s, m/s^2. The car does not
slip sideways, so it moves along its heading; the yaw integrates the gyro less its bias, the speed the forward
acceleration less its bias. The pose network measures (x, y, yaw); differences of yaw are wrapped to (-pi, pi].
All in float64.
"""

import math
from dataclasses import dataclass, fields

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from jaxtyping import Float
from scipy.stats import chi2

from hashnerf.errors import UserError
from worlds.boxes import wrap_angle

LARGEST_POSITION = 1e6
"""Metres from the origin beyond which no pose is believed."""
LARGEST_YAW_RATE, LARGEST_ACCELERATION = 35.0, 160.0
"""No sensor of this kind reads more (2000 degrees per second, 16 g); yaw rates in degrees do."""
LARGEST_DEVIATION = np.array([100.0, 100.0, math.pi, 10.0, 1.0, 10.0])
"""Standard deviations beyond which the state is not known at all."""
SMALLEST = 1e-6
"""Metres or radians: no network is surer than that."""
STEP = 0.05
"""Longest time predicted at once, seconds."""
MEASURED = np.eye(3, 6)


@dataclass(frozen=True)
class PoseFilterConfig:
    """What the filter believes of its two sources and of the car."""

    position_std: float = 0.2
    """Standard deviation of the network's x and of its y where it tells none, metres."""
    yaw_std: float = 8.0
    """Standard deviation of the network's yaw where it tells none, degrees."""
    correlation: float = 4.0
    """Successive pictures whose errors count as one; (1 + r) / (1 - r) where r correlates the errors of neighbours."""
    gyro_noise: float = 0.0002
    """Noise of the yaw rate, rad/s per root hertz: a reading's standard deviation over the root of the rate."""
    accel_noise: float = 0.005
    """Noise of the forward acceleration, m/s^2 per root hertz."""
    gyro_drift: float = 0.0005
    """Random walk of the gyro's bias, rad/s per root second."""
    accel_drift: float = 0.005
    """Random walk of the accelerometer's bias, m/s^2 per root second."""
    gyro_bias_std: float = 0.02
    """Standard deviation of the gyro's bias at the start, rad/s."""
    accel_bias_std: float = 0.1
    """Standard deviation of the accelerometer's bias at the start, m/s^2."""
    slip: float = 0.005
    """Random walk of the position beside what speed and heading explain, metres per root second."""
    first_speed: float = 0.8
    """Speed at the start, m/s; the commanded one where the car drives at constant speed."""
    first_speed_std: float = 0.3
    """Standard deviation of the speed at the start, m/s."""
    gate: float = 0.95
    """Probability with which a sound pose of the network is let through (chi-square of three)."""
    doubt: float = 5.0
    """Standard deviations of the network that the pose may be wrong by from which the filter starts."""
    hypotheses: int = 4
    """Most ideas of where the car is that are followed at a time."""
    memory: float = 30.0
    """Pictures over which it is remembered how well the network agreed with each of them."""
    elsewhere: float = 30.0
    """Square metres over which the network's errors are spread: an idea must explain a pose better than chance."""
    blind_turn: float = 1.0
    """Standard deviation of the yaw rate while there is no reading, rad/s."""
    blind_acceleration: float = 1.0
    """Standard deviation of the acceleration while there is no reading, m/s^2."""
    longest_reading: float = 0.1
    """Seconds that a reading may stand for; what is longer is a gap, driven through at the last yaw rate."""
    longest_gap: float = 2.0
    """Seconds without a reading after which the pose is lost."""

    def __post_init__(self):
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name != "first_speed" and not 0 <= value < math.inf:
                raise UserError(f"pose_filter.{field.name} is {value}; give 0 or a positive number")
        if not math.isfinite(self.first_speed):
            raise UserError(f"pose_filter.first_speed is {self.first_speed}; give a finite number")
        for key in ("position_std", "yaw_std", "elsewhere"):
            if getattr(self, key) < SMALLEST:
                raise UserError(f"pose_filter.{key} is {getattr(self, key)}; give at least {SMALLEST}")
        for key in ("correlation", "doubt", "hypotheses", "memory"):
            if getattr(self, key) < 1:
                raise UserError(f"pose_filter.{key} is {getattr(self, key)}; give at least 1")
        if not 0 < self.gate < 1:
            raise UserError(f"pose_filter.gate is {self.gate}; give a probability between 0 and 1")
        if not 0 < self.longest_reading <= self.longest_gap:
            raise UserError("pose_filter.longest_reading must be positive and no longer than longest_gap")


class PoseFilter:
    """One drive: `predict` takes in readings, `update` poses of the network; it starts with the first usable pose.

    `refused_poses` and `refused_readings` count what was not taken in.
    """

    def __init__(self, config: PoseFilterConfig):
        self.config = config
        self.started = False
        self.refused_poses = self.refused_readings = 0
        self._blind = 0.0
        self._last_turn = 0.0
        self._limit = float(chi2.ppf(config.gate, 3))
        self._noise = np.diag([config.position_std, config.position_std, math.radians(config.yaw_std)]) ** 2
        self._first = np.array([config.first_speed_std, config.gyro_bias_std, config.accel_bias_std]) ** 2
        self._filter = _Motion(dim_x=6, dim_z=3)
        self._filter.x = np.array([0.0, 0.0, 0.0, config.first_speed, 0.0, 0.0])
        self._filter.P = np.diag(np.concatenate([LARGEST_DEVIATION[:3] ** 2, self._first]))

    @property
    def pose(self) -> Float[np.ndarray, " 3"]:
        """(x, y, yaw); raises ValueError before the first usable pose and after a gap that lost it."""
        if not self.started:
            raise ValueError("the pose is not known; give a finite pose to update first")
        return self._filter.x[:3].copy()

    @property
    def state(self) -> Float[np.ndarray, " 6"]:
        """(x, y, yaw, speed, gyro bias, accelerometer bias); the first three mean nothing unless `started`."""
        return self._filter.x.copy()

    @property
    def covariance(self) -> Float[np.ndarray, "6 6"]:
        """Of the state; symmetric, without negative eigenvalues, and bounded."""
        return self._filter.P.copy()

    def predict(self, yaw_rate: float, acceleration: float, dt: float) -> None:
        """Moves on by `dt` seconds with the mean yaw rate (rad/s) and forward acceleration (m/s^2) of that time.

        A `dt` that is not a positive number changes nothing. A reading that is not finite, or more than a sensor can
        read, is refused: the car is taken to go on at its last yaw rate and speed, and the longer it does, the less
        is known. The same holds for a `dt` beyond `longest_reading`; beyond `longest_gap` in all, the pose is lost.
        """
        if not dt > 0:
            self.refused_readings += 1
            return
        if not self.started:
            return
        sound = abs(yaw_rate) <= LARGEST_YAW_RATE and abs(acceleration) <= LARGEST_ACCELERATION
        self.refused_readings += not sound
        if sound and dt <= self.config.longest_reading:
            self._blind = 0.0
        elif self._blind + dt > self.config.longest_gap:
            self._lose()
            return
        if sound:
            self._last_turn = yaw_rate
        blind = not sound or dt > self.config.longest_reading
        push = float(self._filter.x[5]) if blind else acceleration
        steps = max(math.ceil(dt / STEP - 1e-9), 1)
        for _ in range(steps):
            self._step(self._last_turn, push, dt / steps, blind)

    def update(self, pose: Float[np.ndarray, " 3"], deviation: Float[np.ndarray, " 2"] | None = None) -> bool:
        """Takes in the network's (x, y, yaw), metres and radians; returns whether it was used.

        `deviation` is the network's own standard deviation of x and of y (metres) and of yaw (radians). A pose that is
        not finite or beyond LARGEST_POSITION is refused, one with a deviation that is no positive number too, and so is
        one too far from where the car can be (Mahalanobis distance).
        """
        if not sound_pose(pose, deviation):
            self.refused_poses += 1
            return False
        noise = self._noise_of(deviation)
        if not self.started:
            self._begin(pose, noise)
            return True
        off = _difference(pose, self._filter.x[:3])
        if off @ np.linalg.solve(self._filter.P[:3, :3] + noise, off) > self._limit:
            self.refused_poses += 1
            return False
        noise = noise * self.config.correlation
        self._filter.update(pose, lambda x: MEASURED, lambda x: x[:3], R=noise, residual=_difference)
        self._tidy()
        return True

    def evidence(self, pose: Float[np.ndarray, " 3"], deviation: Float[np.ndarray, " 2"] | None = None) -> float:
        """Returns how much a pose of the network speaks for where this filter is: 0 or more, 0 before it started.

        The logarithm of its density here over that of an error, which may lie anywhere within `elsewhere` and turn any
        way; what errors explain better says nothing. A sure network that agrees says more than an unsure one.
        """
        if not self.started or not sound_pose(pose, deviation):
            return 0.0
        off = _difference(pose, self._filter.x[:3])
        covariance = self._filter.P[:3, :3] + self._noise_of(deviation)
        here = -0.5 * float(off @ np.linalg.solve(covariance, off) + np.linalg.slogdet(2 * math.pi * covariance)[1])
        return max(here + math.log(self.config.elsewhere * 2 * math.pi), 0.0)

    def _noise_of(self, deviation: np.ndarray | None) -> Float[np.ndarray, "3 3"]:
        """Covariance of a pose of the network."""
        if deviation is None:
            return self._noise
        place, yaw = np.clip(deviation, SMALLEST, LARGEST_DEVIATION[[0, 2]])
        return np.diag([place, place, yaw]) ** 2

    def _step(self, yaw_rate: float, acceleration: float, dt: float, blind: bool) -> None:
        c = self.config
        density = np.array([c.slip, c.slip, c.gyro_noise, c.accel_noise, c.gyro_drift, c.accel_drift])
        noise = density**2 * dt
        if blind:
            # an unknown but constant rate: its deviation grows with the time since the last reading, not its root
            grown = (self._blind + dt) ** 2 - self._blind**2
            self._blind += dt
            noise[2:4] += np.array([c.blind_turn, c.blind_acceleration]) ** 2 * grown
        self._filter.Q = np.diag(noise)
        self._filter.F = transition(self._filter.x, yaw_rate, acceleration, dt)
        self._filter.predict(np.array([yaw_rate, acceleration, dt]))
        self._tidy()

    def _tidy(self) -> None:
        """Wraps the yaw; makes the covariance symmetric and keeps it within its bounds, which leaves correlations."""
        self._filter.x[2] = wrap_angle(float(self._filter.x[2]))
        covariance = (self._filter.P + self._filter.P.T) / 2
        shrink = LARGEST_DEVIATION / np.maximum(np.sqrt(np.diag(covariance)), LARGEST_DEVIATION)
        self._filter.P = covariance * np.outer(shrink, shrink)

    def _begin(self, pose: np.ndarray, noise: np.ndarray) -> None:
        """Stands at the pose, in doubt of it; speed and biases stay, known no better than at first."""
        self._filter.x[:2] = pose[:2]
        self._filter.x[2] = wrap_angle(float(pose[2]))
        rest = np.maximum(np.diag(self._filter.P)[3:], self._first)
        self._filter.P = np.diag(np.concatenate([self.config.doubt**2 * np.diag(noise), rest]))
        self.started, self._blind = True, 0.0

    def _lose(self) -> None:
        self.started, self._blind, self._last_turn = False, 0.0, 0.0
        rest = np.maximum(np.diag(self._filter.P)[3:], self._first)
        self._filter.P = np.diag(np.concatenate([LARGEST_DEVIATION[:3] ** 2, rest]))


class _Motion(ExtendedKalmanFilter):
    """The library's filter with the car's own motion."""

    def predict_x(self, u: Float[np.ndarray, " 3"]) -> None:
        """Moves the state by u = (yaw rate, acceleration, seconds)."""
        self.x = moved(self.x, float(u[0]), float(u[1]), float(u[2]))


def sound_pose(pose: Float[np.ndarray, " 3"], deviation: Float[np.ndarray, " 2"] | None) -> bool:
    """Whether a pose of the network can be used at all."""
    if deviation is not None and not (np.isfinite(deviation).all() and (deviation > 0).all()):
        return False
    return bool(np.isfinite(pose).all() and np.abs(pose[:2]).max() <= LARGEST_POSITION)


def moved(state: Float[np.ndarray, " 6"], yaw_rate: float, acceleration: float, dt: float) -> Float[np.ndarray, " 6"]:
    """Returns the state `dt` seconds on: an arc, exact for constant yaw rate and speed. The yaw is not wrapped."""
    x, y, yaw, speed, gyro_bias, accel_bias = state
    half = (yaw_rate - gyro_bias) * dt / 2
    push = acceleration - accel_bias
    chord = (speed * dt + push * dt**2 / 2) * np.sinc(half / np.pi)
    return np.array(
        [
            x + chord * np.cos(yaw + half),
            y + chord * np.sin(yaw + half),
            yaw + 2 * half,
            speed + push * dt,
            gyro_bias,
            accel_bias,
        ]
    )


def transition(
    state: Float[np.ndarray, " 6"], yaw_rate: float, acceleration: float, dt: float
) -> Float[np.ndarray, "6 6"]:
    """Returns the Jacobian of `moved` with respect to the state."""
    yaw, speed = float(state[2]), float(state[3])
    half = (yaw_rate - float(state[4])) * dt / 2
    push = acceleration - float(state[5])
    way, sinc = speed * dt + push * dt**2 / 2, float(np.sinc(half / math.pi))
    # the derivative of sin(a) / a; its series where the difference would cancel
    slope = (math.cos(half) - sinc) / half if abs(half) > 1e-3 else -half / 3
    cos, sin = math.cos(yaw + half), math.sin(yaw + half)
    matrix = np.eye(6)
    matrix[:2, 2] = -way * sinc * sin, way * sinc * cos
    matrix[:2, 3] = dt * sinc * cos, dt * sinc * sin
    matrix[:2, 4] = -dt / 2 * way * (slope * cos - sinc * sin), -dt / 2 * way * (slope * sin + sinc * cos)
    matrix[:2, 5] = -(dt**2) / 2 * sinc * cos, -(dt**2) / 2 * sinc * sin
    matrix[2, 4] = -dt
    matrix[3, 5] = -dt
    return matrix


def _difference(pose: np.ndarray, other: np.ndarray) -> np.ndarray:
    difference = pose - other
    difference[2] = wrap_angle(float(difference[2]))
    return difference
