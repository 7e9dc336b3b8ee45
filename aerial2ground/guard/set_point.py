"""The set-point that goes to the car: it follows what is asked for at bounded rates, and slower through curves."""

import math

from aerial2ground.guard.actuation import Actuation

PERIOD = 0.02
"""Seconds between two set-points."""


class SetPoint:
    """Steering (rad) and speed (m/s) as they are sent."""

    def __init__(self, actuation: Actuation):
        self.steering = self.speed = 0.0
        self._car = actuation
        self._last = -math.inf

    def follow(self, steering: float, speed: float, now: float) -> None:
        """Moves towards a steering angle and a speed; after a pause as far as one period allows, no farther."""
        seconds = self._seconds(now)
        self.steering = _towards(self.steering, steering, self._car.steering_rate * seconds)
        allowed = min(speed, self.fastest(max(abs(self.steering), abs(steering))))
        self.speed = min(allowed, self.speed + self._car.acceleration * seconds)

    def ramp_down(self, now: float) -> None:
        """Holds the steering and slows down."""
        self.speed = max(0.0, self.speed - self._car.acceleration * self._seconds(now))

    def stand(self, steering: float, now: float) -> None:
        """No speed; turns the wheels at their rate."""
        self.speed = 0.0
        self.steering = _towards(self.steering, steering, self._car.steering_rate * self._seconds(now))

    def fastest(self, steering: float) -> float:
        """The speed (m/s) at which this steering angle (rad, positive) makes the largest acceleration across."""
        curvature = math.tan(steering) / self._car.wheelbase
        return math.sqrt(self._car.lateral_acceleration / curvature) if curvature > 0 else math.inf

    def _seconds(self, now: float) -> float:
        seconds = min(now - self._last, PERIOD)
        self._last = now
        return seconds


def _towards(value: float, target: float, step: float) -> float:
    return value + min(max(target - value, -step), step)
