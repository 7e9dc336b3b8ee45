"""One car's file: what its motor controller and servo are told, and how its camera sees (`configs/cars/*.yaml`)."""

import math
from dataclasses import dataclass, field
from pathlib import Path

from aerial2ground.guard.actuation import Actuation
from hashnerf.command_line import load_config, read_yaml
from hashnerf.errors import UserError

MEASURED = ("speed_to_erpm_gain", "servo_gain", "servo_offset", "steering_limit", "wheelbase")
"""Of `actuation`: no two cars are alike in these."""


@dataclass(frozen=True)
class CameraCalibration:
    """The car's camera: an OPENCV lens as in `transforms.json`, whose first pixel has its centre at (0.5, 0.5).

    Raises UserError naming the key and what to give.
    """

    width: int
    """Pixels across of the pictures that the device gives."""
    height: int
    """Pixels down."""
    fl_x: float
    """Focal length across, pixels."""
    fl_y: float
    """Focal length down, pixels."""
    cx: float
    """Where the optical axis meets the picture, pixels from its left edge."""
    cy: float
    """The same, pixels from its upper edge."""
    k1: float = 0.0
    """Radial distortion, of the radius squared."""
    k2: float = 0.0
    """Radial distortion, of the radius to the fourth."""
    p1: float = 0.0
    """Tangential distortion, as OpenCV's p1."""
    p2: float = 0.0
    """Tangential distortion, as OpenCV's p2."""
    pitch: float = 0.0
    """Degrees above the horizon; a camera that looks down at the road has a negative one."""
    stereo: bool = False
    """Whether the device gives the pictures of two eyes side by side (a ZED without its SDK); the left one is used."""

    @property
    def device_width(self) -> int:
        """Pixels across of what the device gives: of both eyes, where it has two."""
        return 2 * self.width if self.stereo else self.width

    def __post_init__(self):
        for key in ("width", "height"):
            self._require(key, 8, 8192, "give the pixels of the device's pictures, 8 to 8192")
        for key, side in (("fl_x", self.width), ("fl_y", self.height)):
            self._require(key, 0.1 * side, 20 * side, "give the focal length in pixels, not in millimetres")
        if not 0.5 <= self.fl_x / self.fl_y <= 2:
            raise UserError(f"fl_x is {self.fl_x} and fl_y {self.fl_y}; give two numbers of about the same size")
        self._require("cx", 0, self.width, "give pixels from the left edge, about half of width")
        self._require("cy", 0, self.height, "give pixels from the upper edge, about half of height")
        for key in ("k1", "k2", "p1", "p2"):
            self._require(key, -5, 5, "give a coefficient of the OPENCV lens, 0 for a rectified picture")
        self._require("pitch", -80, 80, "give degrees above the horizon, -80 to 80, negative for a camera looking down")

    def _require(self, key: str, low: float | int, high: float | int, what_to_do: str) -> None:
        value = getattr(self, key)
        if not (math.isfinite(value) and low <= value <= high):
            raise UserError(f"{key} is {value}; {what_to_do}")


@dataclass(frozen=True)
class CarFile:
    """What the bridge must know of one car."""

    camera: CameraCalibration
    """How its camera sees."""
    actuation: Actuation = field(default_factory=Actuation)
    """What its motor controller and servo are told."""


def load_car(path: Path) -> CarFile:
    """Reads one car's file; raises UserError naming the file, the whole key and what to do.

    What every car has of its own must stand in the file: another car's gain would drive at another speed unnoticed.
    """
    if not path.is_file():
        raise UserError(f"{path}: no such car file; start from configs/cars/f1tenth.yaml and give yours with --car")
    try:
        car, stated = load_config(CarFile, path), read_yaml(path).get("actuation", {})
        lacking = [key for key in MEASURED if key not in stated]
        if lacking:
            raise UserError(f"actuation lacks {', '.join(lacking)}; measure them (docs/deploy.md)")
        return car
    except UserError as error:
        sentence = str(error).replace(": give it as an argument or in a --config file.", "; write it into the file")
        raise UserError(sentence if sentence.startswith(f"{path}: ") else f"{path}: {sentence}") from error
