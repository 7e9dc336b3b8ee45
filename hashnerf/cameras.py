"""Cameras and their rays.

`pose` is camera-to-world, OpenGL axes (x right, y up, the camera looks along -z), metres. Pixels are image coordinates
(x right, y down) whose first pixel has its centre at (0.5, 0.5). `focal` is (fl_x, fl_y) and `centre` (cx, cy), in
pixels; `distortion` is (k1, k2, p1, p2) of the OPENCV lens. Depth is the distance along the optical axis, in metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from hashnerf.errors import UserError
from hashnerf.lens import distort, largest_radius, undistort
from hashnerf.ray_box import intersect_box
from hashnerf.rays import Rays, unit_directions

UNDISTORTION_TOLERANCE = 1e-6  # pixels


@dataclass(frozen=True)
class Cameras:
    """Cameras that share one image size; one row a camera."""

    pose: Float[Tensor, "n 4 4"]
    focal: Float[Tensor, "n 2"]
    centre: Float[Tensor, "n 2"]
    distortion: Float[Tensor, "n 4"]
    width: int
    height: int

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise UserError(f"the image size is {self.width}x{self.height}; both sides need at least one pixel")

    def __len__(self) -> int:
        return self.pose.shape[0]

    @cached_property
    def is_pinhole(self) -> bool:
        """Whether no camera has lens distortion."""
        return not bool(self.distortion.any())

    def select(self, index: Int[Tensor, " chosen"] | Sequence[int] | slice) -> "Cameras":
        """Some of the cameras, in the order given."""
        rows = index if isinstance(index, (slice, Tensor)) else list(index)
        tensors = {name: getattr(self, name)[rows] for name in ("pose", "focal", "centre", "distortion")}
        return replace(self, **tensors)

    def scaled(self, width: int, height: int) -> "Cameras":
        """The same cameras with another image size: focal length and centre scale exactly with the sides."""
        factor = self.focal.new_tensor([width / self.width, height / self.height])
        return replace(self, focal=self.focal * factor, centre=self.centre * factor, width=width, height=height)

    def to(self, device: torch.device | str) -> "Cameras":
        """The same cameras on another device."""
        tensors = {name: getattr(self, name).to(device) for name in ("pose", "focal", "centre", "distortion")}
        return replace(self, **tensors)


def camera_rays(cameras: Cameras, camera_index: Int[Tensor, " rays"], pixel: Float[Tensor, "rays 2"]) -> Rays:
    """World rays through image points; differentiable with respect to `cameras.pose`.

    A distorted lens passes no gradient to `focal`, `centre`, `distortion` or `pixel`; a pinhole does. Raises UserError
    where the lens cannot be inverted at a pixel.
    """
    focal = cameras.focal[camera_index]
    point = (pixel - cameras.centre[camera_index]) / focal
    if not cameras.is_pinhole:
        tolerance = UNDISTORTION_TOLERANCE / focal.detach().double().amax(-1)
        point, good = undistort(point, cameras.distortion[camera_index], tolerance)
        if not bool(good.all()):
            row = int((~good).nonzero()[0])
            raise UserError(
                f"the lens of camera {int(camera_index[row])} cannot be inverted at pixel {pixel[row].tolist()}; "
                "its distortion folds back there: check k1 and k2, or crop the image"
            )
    pose = cameras.pose[camera_index]
    # Image y points down and the camera looks along -z: the OpenGL direction is (x, -y, -1).
    direction = torch.stack([point[:, 0], -point[:, 1], -torch.ones_like(point[:, 0])], dim=-1).to(pose.dtype)
    with torch.autocast(pose.device.type, enabled=False):  # half precision turns rays by whole pixels
        world = (pose[:, :3, :3] @ direction[:, :, None])[:, :, 0]
    return Rays(pose[:, :3, 3], unit_directions(world))


def image_rays(cameras: Cameras, index: int) -> Rays:
    """Rays through every pixel centre of one camera, row by row: height * width rays."""
    device, dtype = cameras.focal.device, cameras.focal.dtype
    x = torch.arange(cameras.width, device=device, dtype=dtype) + 0.5
    y = torch.arange(cameras.height, device=device, dtype=dtype) + 0.5
    rows, columns = torch.meshgrid(y, x, indexing="ij")
    pixel = torch.stack([columns.reshape(-1), rows.reshape(-1)], dim=-1)
    camera_index = torch.full((pixel.shape[0],), index, device=device)
    return camera_rays(cameras, camera_index, pixel)


def project(
    cameras: Cameras, camera_index: Int[Tensor, " n"], points: Float[Tensor, "n 3"]
) -> tuple[Float[Tensor, "n 2"], Float[Tensor, " n"]]:
    """World points -> image coordinates and depth along the optical axis (metres); the inverse of `camera_rays`.

    The pixel is NaN for points behind the camera (depth <= 0) or beyond the radius where the lens folds back.
    """
    pose = cameras.pose[camera_index]
    with torch.autocast(pose.device.type, enabled=False):
        local = (pose[:, :3, :3].transpose(1, 2) @ (points - pose[:, :3, 3])[:, :, None])[:, :, 0]
    depth = -local[:, 2]
    visible = depth > 0
    safe_depth = torch.where(visible, depth, torch.ones_like(depth))
    point = torch.stack([local[:, 0], -local[:, 1]], dim=-1) / safe_depth[:, None]
    if not cameras.is_pinhole:
        distortion = cameras.distortion[camera_index]
        visible = visible & (point.norm(dim=-1) < largest_radius(distortion))
        # A hidden point's powers could overflow, and the gradient through `where` would then be NaN.
        point = distort(torch.where(visible[:, None], point, torch.zeros_like(point)), distortion)
    pixel = point * cameras.focal[camera_index] + cameras.centre[camera_index]
    return torch.where(visible[:, None], pixel, torch.full_like(pixel, torch.nan)), depth


def any_sees(cameras: Cameras, box: Float[Tensor, "2 3"]) -> bool:
    """Whether the axis of some camera meets an axis-aligned box (metres), or some camera sees a point of it.

    Looked for are the points of a lattice, 9 to a side: only a sliver of a box in a corner of a picture is overlooked.
    """
    pose = cameras.pose
    if bool(intersect_box(pose[:, :3, 3], -pose[:, :3, 2], box)[2].any()):
        return True
    share = torch.linspace(0, 1, 9).to(box)
    points = box[0] + torch.cartesian_prod(share, share, share) * (box[1] - box[0])
    number = torch.arange(len(cameras), device=pose.device).repeat_interleave(len(points))
    pixel, _ = project(cameras, number, points.repeat(len(cameras), 1))
    size = torch.tensor([cameras.width, cameras.height]).to(pixel)
    return bool(((pixel >= 0) & (pixel < size)).all(dim=1).any())  # NaN, behind the camera, is neither


def look_at(
    position: Float[Tensor, " 3"] | Sequence[float | int],
    target: Float[Tensor, " 3"] | Sequence[float | int],
    up: Float[Tensor, " 3"] | Sequence[float | int] = (0, 0, 1),
) -> Float[Tensor, "4 4"]:
    """A camera-to-world pose at `position` that looks at `target` with `up` upwards in the image (metres, float32).

    Raises UserError when the target is the position, or when the view runs along `up` (looking straight down needs
    another `up`, for example (0, 1, 0)).
    """
    eye, aim, sky = (torch.as_tensor(value, dtype=torch.float64).cpu() for value in (position, target, up))
    backward = eye - aim
    if not bool(torch.isfinite(backward).all()) or not bool(backward.any()):
        raise UserError(f"look_at: position {eye.tolist()} and target {aim.tolist()} must be finite and differ")
    backward = unit_directions(backward)
    right = torch.linalg.cross(sky, backward)
    if not bool(right.norm() > 1e-9 * sky.norm()):
        raise UserError(f"look_at: the view runs along up = {sky.tolist()}; give an up that is not the viewing line")
    right = unit_directions(right)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, torch.linalg.cross(backward, right), backward, eye
    return pose.float()
