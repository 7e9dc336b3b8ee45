"""What a car's commands mean to its motor controller and servo, and what the car may be asked for: one car's numbers.

The defaults are those of F1TENTH and the MIT racecar (f1tenth_stack/config/vesc.yaml).
"""

import math
from dataclasses import dataclass, fields

from hashnerf.errors import UserError

FASTEST = 2.0
"""m/s: no calibration may allow more."""


@dataclass(frozen=True)
class Actuation:
    """Gains, offsets and limits of one car; raises UserError naming the key and what to give."""

    speed_to_erpm_gain: float = 4614.0
    """Electrical revolutions per minute at 1 m/s."""
    servo_gain: float = -1.2135
    """Servo position per radian of steering to the left; its sign is that of the linkage."""
    servo_offset: float = 0.5304
    """Servo position at which the car drives straight on."""
    servo_min: float = 0.15
    """Servo positions below it are never sent."""
    servo_max: float = 0.85
    """Servo positions above it are never sent."""
    steering_limit: float = 0.263
    """Largest steering angle to either side, radians."""
    steering_rate: float = 3.2
    """Fastest change of the steering angle, rad/s."""
    wheelbase: float = 0.325
    """Metres between the axles."""
    speed_limit: float = 1.0
    """Largest speed, m/s; at most 2."""
    acceleration: float = 2.5
    """Fastest growth of the speed, m/s^2; it may fall at once."""
    lateral_acceleration: float = 3.0
    """Largest acceleration across in a curve, m/s^2 (ISO 11270)."""
    brake_current: float = 10.0
    """Amperes with which the motor brakes."""
    lowest_voltage: float = 9.5
    """Volts below which the battery is empty (three cells)."""
    highest_voltage: float = 13.0
    """Volts above which it is not the battery that these numbers are for."""
    highest_temperature: float = 80.0
    """Of the controller's power stage, degrees Celsius."""

    def __post_init__(self):
        for field in fields(self):
            if not math.isfinite(getattr(self, field.name)):
                raise UserError(f"{field.name} is {getattr(self, field.name)}; give a finite number")
        self._require("speed_to_erpm_gain", 100, 100_000, "give the positive erpm at 1 m/s (F1TENTH: 4614)")
        self._require("servo_min", 0, 0.5, "give a servo position from 0 to 0.5")
        self._require("servo_max", 0.5, 1, "give a servo position from 0.5 to 1")
        self._require("servo_offset", self.servo_min, self.servo_max, "give a position from servo_min to servo_max")
        if not 0.1 <= abs(self.servo_gain) <= 10:
            raise UserError(f"servo_gain is {self.servo_gain}; give servo position per radian (F1TENTH: -1.2135)")
        self._require("steering_limit", 0.01, 1.2, "give radians above 0 and below 1.2 (15 degrees are 0.262)")
        room = min(self.servo_max - self.servo_offset, self.servo_offset - self.servo_min) / abs(self.servo_gain)
        if self.steering_limit > room + 1e-9:
            raise UserError(
                f"steering_limit is {self.steering_limit} rad, which the servo's range does not reach to both sides; "
                f"give at most {math.floor(room * 1000) / 1000}"
            )
        self._require("steering_rate", 0.1, 50, "give positive rad/s (F1TENTH: 3.2)")
        self._require("wheelbase", 0.05, 3, "give metres between the axles (F1TENTH: 0.325)")
        self._require("speed_limit", 0.05, FASTEST, f"give m/s, at most {FASTEST}")
        self._require("acceleration", 0.1, 20, "give positive m/s^2 (F1TENTH: 2.5)")
        self._require("lateral_acceleration", 0.1, 20, "give positive m/s^2 (ISO 11270: 3)")
        self._require("brake_current", 1, 100, "give positive amperes, at least 1 (F1TENTH: 10)")
        self._require("lowest_voltage", 3, 60, "give volts (three cells: 9.5)")
        self._require("highest_voltage", self.lowest_voltage, 60, "give volts above lowest_voltage (three cells: 13)")
        self._require("highest_temperature", 30, 120, "give degrees Celsius (80)")

    def _require(self, key: str, low: float | int, high: float | int, what_to_do: str) -> None:
        if not low <= getattr(self, key) <= high:
            raise UserError(f"{key} is {getattr(self, key)}; {what_to_do}")

    def servo(self, steering: float) -> float:
        """Returns the servo position of a steering angle (rad)."""
        return self.servo_gain * steering + self.servo_offset

    def erpm(self, speed: float) -> float:
        """Returns the electrical speed (1/min) of a speed (m/s)."""
        return self.speed_to_erpm_gain * speed

    def speed(self, erpm: float | int) -> float:
        """Returns the speed (m/s) of an electrical speed (1/min)."""
        return erpm / self.speed_to_erpm_gain
