"""The device's picture becomes the picture that the policy was trained on: a pinhole of its size, view and pitch.

Camera frames here are OpenCV's (x right, y down, z forward). Focal lengths and centres are the project's, whose first
pixel has its centre at (0.5, 0.5); OpenCV counts it as (0, 0), hence the halves.
"""

import math

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from aerial2ground.bridge.car_file import CameraCalibration
from aerial2ground.exported_policy import PolicyInfo
from hashnerf.errors import UserError

MISSING = 0.02
"""Share of the policy's picture that may lie outside the device's; the device's edge pixels are repeated there."""


class Rectifier:
    """Turns uint8 RGB pictures of the device into those of the policy; one thread at a time.

    Pictures are reduced a lot (672 x 376 to 48 x 27), so they are first mapped to a whole multiple of the policy's
    size, about as fine as the device's, and then averaged: taking single pixels would alias.

    Raises UserError where more than `MISSING` of the policy's picture lies outside what the device sees.
    """

    def __init__(self, lens: CameraCalibration, info: PolicyInfo):
        self._lens, self._info = lens, info
        focal = policy_focal(info)
        self.identity = _is_same(lens, info)
        """Whether device and policy see alike; then pictures pass untouched."""
        if self.identity:
            return
        self.multiple = max(1, math.ceil(max(lens.fl_x, lens.fl_y) / focal - 1e-6))
        """Pixels of the mapped picture across each pixel of the policy's."""
        columns, rows = _maps(lens, info, self.multiple)
        missing = 1 - float(_seen(lens, info, self.multiple, columns, rows).mean())
        if missing >= MISSING:
            raise UserError(
                f"{100 * missing:.0f} % of the policy's picture ({info.field_of_view:g} degrees across, pitch "
                f"{info.pitch:g}) lies outside the picture of the car's camera ({_degrees_across(lens):.0f} degrees "
                f"across, pitch {lens.pitch:g}); tilt the camera, or train a policy for a narrower field of view"
            )
        self._maps = cv2.convertMaps(columns, rows, cv2.CV_16SC2)

    def __call__(self, picture: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "height width 3"]:
        """Returns the policy's picture; raises UserError for a picture of another size than the calibration's."""
        lens, info = self._lens, self._info
        if picture.shape[:2] != (lens.height, lens.device_width):
            eyes = ", two eyes side by side" if lens.stereo else ""
            raise UserError(
                f"the camera gives pictures of {picture.shape[1]} x {picture.shape[0]} pixels, but the car's file says "
                f"camera.width and camera.height are {lens.width} x {lens.height}{eyes}; mend either"
            )
        left = np.ascontiguousarray(picture[:, : lens.width]) if lens.stereo else picture
        if self.identity:
            return left
        mapped = cv2.remap(left, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return cv2.resize(mapped, (info.width, info.height), interpolation=cv2.INTER_AREA)


def policy_focal(info: PolicyInfo) -> float:
    """Returns the focal length (pixels, across and down) of the pinhole camera that a policy was trained for."""
    return 0.5 * info.width / math.tan(math.radians(info.field_of_view) / 2)


def turn(degrees: float) -> Float[np.ndarray, "3 3"]:
    """Returns the rotation about the x axis that raises the forward axis by an angle above the horizon."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _is_same(lens: CameraCalibration, info: PolicyInfo) -> bool:
    focal = policy_focal(info)
    own = (lens.fl_x, lens.fl_y, lens.cx, lens.cy, lens.pitch, lens.k1, lens.k2, lens.p1, lens.p2)
    wanted = (focal, focal, info.width / 2, info.height / 2, info.pitch, 0.0, 0.0, 0.0, 0.0)
    return (lens.width, lens.height) == (info.width, info.height) and bool(np.allclose(own, wanted, 1e-9, 1e-9))


def _maps(
    lens: CameraCalibration, info: PolicyInfo, multiple: int
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Returns where in the device's picture (OpenCV's pixels) each pixel of the mapped picture comes from."""
    focal, size = multiple * policy_focal(info), (multiple * info.width, multiple * info.height)
    device = np.array([[lens.fl_x, 0, lens.cx - 0.5], [0, lens.fl_y, lens.cy - 0.5], [0, 0, 1]])
    mapped = np.array([[focal, 0, size[0] / 2 - 0.5], [0, focal, size[1] / 2 - 0.5], [0, 0, 1]])
    distortion = np.array([lens.k1, lens.k2, lens.p1, lens.p2])
    # a direction in the device's frame, raised by the device's pitch and lowered by the policy's, is in the policy's
    change = turn(lens.pitch - info.pitch)
    columns, rows = cv2.initUndistortRectifyMap(device, distortion, change, mapped, size, cv2.CV_32FC1)
    return columns, rows


def _seen(
    lens: CameraCalibration,
    info: PolicyInfo,
    multiple: int,
    columns: Float[np.ndarray, "h w"],
    rows: Float[np.ndarray, "h w"],
) -> Bool[np.ndarray, "h w"]:
    """Returns which pixels of the mapped picture the device sees: before its lens, inside its picture, and not folded.

    A strong distortion bends far directions back into the picture; these show something else.
    """
    focal, (height, width) = multiple * policy_focal(info), columns.shape
    x = (np.arange(width) + 0.5 - width / 2) / focal
    y = (np.arange(height) + 0.5 - height / 2) / focal
    directions = np.stack([*np.meshgrid(x, y), np.ones(columns.shape)], axis=-1) @ turn(lens.pitch - info.pitch)
    before = directions[..., 2] > 1e-6
    square = (directions[..., 0] ** 2 + directions[..., 1] ** 2) / np.where(before, directions[..., 2], 1.0) ** 2
    inside = (columns >= -0.5) & (columns <= lens.width - 0.5) & (rows >= -0.5) & (rows <= lens.height - 0.5)
    return before & inside & (square < _fold(lens))


def _fold(lens: CameraCalibration) -> float:
    """Returns the squared radius (of the undistorted point) from which the lens's radius no longer grows.

    It is the first positive root s of d/dr (r + k1 r^3 + k2 r^5) = 1 + 3 k1 s + 5 k2 s^2; infinite without one.
    """
    roots = np.roots([5 * lens.k2, 3 * lens.k1, 1.0])
    return min((float(root.real) for root in roots if abs(root.imag) < 1e-12 and root.real > 0), default=math.inf)


def _degrees_across(lens: CameraCalibration) -> float:
    """Returns the angle that the device sees across, its distortion left aside."""
    return math.degrees(math.atan(lens.cx / lens.fl_x) + math.atan((lens.width - lens.cx) / lens.fl_x))
