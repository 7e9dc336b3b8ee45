"""Points of the ground followed from picture to picture.

Every picture is laid onto the ground plane from where the drone believed to be. There the same piece of road or lawn
looks alike from everywhere and lies within a few centimetres of its place, so corners of one picture are found in the
others by optical flow. Where they are in the pictures themselves is what a bundle adjustment wants to know.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from aerial2ground.bundle_adjustment import Sightings
from hashnerf.cameras import Cameras, camera_rays, project

LARGEST_RASTER = 8192
"""Pixels along a side of the plane."""
COARSEST = 6.0
"""A picture's pixel that covers more ground than this many raster pixels is left out: it looks along the ground."""
APART = 10
"""Raster pixels between corners."""
MARGIN = 4
"""Raster pixels along the edges of a picture on the ground in which nothing is trusted."""
RETURN, UNLIKE = 0.5, 30.0
"""Raster pixels by which a place followed there and back may miss; grey levels by which its windows may differ."""
LEAST_SHARED = 5
"""Corners that two pictures must share to be compared."""


@dataclass(frozen=True)
class Raster:
    """Squares of a plane z = `height`, metres; column and row 0 lie at `low`."""

    low: tuple[float, float]
    pixel: float
    columns: int
    rows: int
    height: float

    @classmethod
    def over(cls, cameras: Cameras, box: Float[Tensor, "2 3"], height: float) -> "Raster":
        """Covers a box with squares as large as a picture's pixel is on the ground below the median camera."""
        above = (cameras.pose[:, 2, 3] - height).clamp(min=1e-3)
        low, high = box[0].tolist(), box[1].tolist()
        least = max(high[0] - low[0], high[1] - low[1]) / LARGEST_RASTER
        pixel = max(float((above / cameras.focal[:, 0]).median()), least)
        columns, rows = (max(int((high[axis] - low[axis]) / pixel), 1) for axis in (0, 1))
        return cls((low[0], low[1]), pixel, columns, rows, height)

    def points(self, columns: Float[np.ndarray, "*n"], rows: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n 3"]:
        """Places of squares, metres."""
        x, y = self.low[0] + columns * self.pixel, self.low[1] + rows * self.pixel
        return np.stack([x, y, np.full_like(x, self.height)], axis=-1)


@dataclass(frozen=True)
class GroundPicture:
    """What a picture shows of the plane: a window of the raster whose first square is (`column`, `row`)."""

    grey: UInt8[np.ndarray, "h w"]
    valid: UInt8[np.ndarray, "h w"]
    column: int
    row: int

    def window(self, left: int, top: int, right: int, bottom: int) -> tuple[np.ndarray, np.ndarray]:
        """The part between squares of the raster, which the picture must cover; grey and valid."""
        rows, columns = slice(top - self.row, bottom - self.row), slice(left - self.column, right - self.column)
        return np.ascontiguousarray(self.grey[rows, columns]), self.valid[rows, columns]


def laid_on_ground(
    picture: UInt8[np.ndarray, "h w 3"], cameras: Cameras, index: int, raster: Raster
) -> GroundPicture | None:
    """Lays a picture onto the plane; None where it shows too little of it."""
    window = _footprint(cameras, index, raster)
    if window is None:
        return None
    left, top, right, bottom = window
    columns, rows = np.meshgrid(np.arange(left, right, dtype=np.float64), np.arange(top, bottom, dtype=np.float64))
    points = torch.from_numpy(raster.points(columns, rows)).float().view(-1, 3)
    pixel, depth = project(cameras, torch.full((len(points),), index), points)
    place = pixel.numpy().reshape(*columns.shape, 2)
    coarse = depth.numpy().reshape(columns.shape) > COARSEST * raster.pixel * float(cameras.focal[index, 0])
    size = np.array([cameras.width, cameras.height])
    inside = ((place > 1) & (place < size - 1)).all(axis=-1) & ~coarse  # NaN, behind the camera, is not
    place = np.where(inside[..., None], place, -1.0).astype(np.float32)
    # the library counts pixels from the middle of the first one
    grey = cv2.remap(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), place - 0.5, None, cv2.INTER_LINEAR)
    square = np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), np.uint8)
    return GroundPicture(grey, cv2.erode(inside.astype(np.uint8), square, borderValue=0), left, top)


def _footprint(cameras: Cameras, index: int, raster: Raster) -> tuple[int, int, int, int] | None:
    """Squares around what a picture shows of the plane, from the rays of a lattice of its pixels."""
    share = torch.linspace(0.0, 1.0, 13)
    pixel = torch.cartesian_prod(share * cameras.width, share * cameras.height)
    rays = camera_rays(cameras, torch.full((len(pixel),), index), pixel)
    down = (raster.height - rays.origins[:, 2]) / rays.directions[:, 2]
    met = (down > 0) & (down < 2 * COARSEST * raster.pixel * float(cameras.focal[index, 0]))
    if not bool(met.any()):
        return None
    places = (rays.origins + rays.directions * down[:, None])[met, :2].double().numpy()
    squares = (places - np.array(raster.low)) / raster.pixel
    low = np.clip(np.floor(squares.min(axis=0)), 0, [raster.columns, raster.rows]).astype(int)
    high = np.clip(np.ceil(squares.max(axis=0)), 0, [raster.columns, raster.rows]).astype(int)
    if (high - low).min() < 4 * MARGIN:
        return None
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def track_ground(
    pictures: UInt8[np.ndarray, "n h w 3"], cameras: Cameras, raster: Raster, corners: int, reach: Int[np.ndarray, " n"]
) -> Sightings:
    """Follows up to `corners` corners of every picture into all others that show them.

    `reach` is how often a picture on the ground is halved: the first look is as wide as 2 to this power windows. Of two
    pictures the wider counts.
    """
    laid = [laid_on_ground(picture, cameras, index, raster) for index, picture in enumerate(pictures)]
    camera, point, squares, points = [], [], [], 0
    for index, own in enumerate(laid):
        found = None if own is None else cv2.goodFeaturesToTrack(own.grey, corners, 0.01, APART, mask=own.valid)
        if own is None or found is None:
            continue
        places = found[:, 0].astype(np.float64) + np.array([own.column, own.row])
        numbers = points + np.arange(len(places))
        points += len(places)
        camera.append(np.full(len(places), index))
        point.append(numbers)
        squares.append(places)
        for other, picture in enumerate(laid):
            if picture is None or other == index:
                continue
            rows, there = _followed(own, picture, places, int(max(reach[index], reach[other])))
            camera.append(np.full(len(rows), other))
            point.append(numbers[rows])
            squares.append(there)
    if not points:
        return Sightings.none()
    numbers, where = np.concatenate(camera), np.concatenate(squares)
    return Sightings(numbers, np.concatenate(point), _ideal_points(cameras, numbers, where, raster)).repeated(3)


def _followed(
    own: GroundPicture, other: GroundPicture, places: Float[np.ndarray, "n 2"], reach: int
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k 2"]]:
    """Which places of one picture are found in another, and where there; tracked back they must arrive again."""
    nothing = np.zeros(0, int), np.zeros((0, 2))
    left, top = max(own.column, other.column), max(own.row, other.row)
    right = min(own.column + own.grey.shape[1], other.column + other.grey.shape[1])
    bottom = min(own.row + own.grey.shape[0], other.row + other.grey.shape[0])
    if min(right - left, bottom - top) < 4 * MARGIN:
        return nothing
    (here, _), (there, valid) = (one.window(left, top, right, bottom) for one in (own, other))
    local = (places - [left, top]).astype(np.float32)
    rows = np.nonzero(_lookup(valid, local))[0]
    if len(rows) < LEAST_SHARED:
        return nothing
    size = 9 + 4 * reach
    settings = {"winSize": (size, size), "maxLevel": reach, "criteria": (3, 20, 0.01)}
    start = local[rows, None]
    found, sound, unlike = cv2.calcOpticalFlowPyrLK(here, there, start, None, **settings)
    back, again, _ = cv2.calcOpticalFlowPyrLK(there, here, found, None, **settings)
    returned = np.linalg.norm(back - start, axis=2)[:, 0]
    kept = (sound[:, 0] > 0) & (again[:, 0] > 0) & (returned < RETURN) & (unlike[:, 0] < UNLIKE)
    kept &= _lookup(valid, found[:, 0])
    return rows[kept], found[kept, 0].astype(np.float64) + np.array([left, top])


def _lookup(valid: UInt8[np.ndarray, "h w"], places: Float[np.ndarray, "n 2"]) -> np.ndarray:
    column, row = np.rint(np.where(np.isfinite(places), places, -1.0)).astype(int).T
    inside = (column >= 0) & (column < valid.shape[1]) & (row >= 0) & (row < valid.shape[0])
    return inside & (valid[np.where(inside, row, 0), np.where(inside, column, 0)] > 0)


def _ideal_points(
    cameras: Cameras, camera: Int[np.ndarray, " k"], squares: Float[np.ndarray, "k 2"], raster: Raster
) -> Float[np.ndarray, "k 2"]:
    """Where the plane's squares are in the pictures, as image points without lens at unit distance (x right, y up).

    The plane was laid out with these poses and the lens, so going back with the same leaves what the pictures show.
    """
    pose = cameras.pose.double().numpy()[camera]
    away = raster.points(squares[:, 0], squares[:, 1]) - pose[:, :3, 3]
    local = np.einsum("kji,kj->ki", pose[:, :3, :3], away)
    return local[:, :2] / -local[:, 2:]
