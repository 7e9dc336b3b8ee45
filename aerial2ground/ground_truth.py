"""What the embedded town really looks like from the ground, and how far views of a radiance field are from that.

*Road* pixels show asphalt, markings or pavement; *foreground* pixels show anything that stands (houses, trees, cars):
a constant sky, and a lawn of one green, would flatter the mean over whole pictures. *Hidden* road pixels show places
that no picture from above shows: only there a prior can tell what pictures cannot. Depth is along the optical axis.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from hashnerf.cameras import Cameras, image_rays, project
from hashnerf.metrics import psnr, ssim
from worlds.scenarios import world_from_description
from worlds.scene import Scene, World

ROAD = ("road", "markings", "pavement")
FLAT = (*ROAD, "floor", "lawn")
NEAR = 2.0
"""Metres up to which the road's depth is judged."""
SURFACE = 0.01
"""A ray that ends this close to a point (m) has met its surface."""


@dataclass(frozen=True)
class TrueView:
    """One camera's picture with masks."""

    rgb: UInt8[Tensor, "h w 3"]
    depth: Float[Tensor, "h w"]
    road: Bool[Tensor, "h w"]
    foreground: Bool[Tensor, "h w"]
    hidden: Bool[Tensor, "h w"]
    """Road that no camera above sees; nothing where no camera above is given."""


def true_views(world: World, cameras: Cameras, above: Cameras | None = None) -> list[TrueView]:
    """Renders the town from every camera; `above` are the cameras whose pictures a field is made of."""
    scene = Scene(world, {})
    road = [world.object_id(name) for name in ROAD]
    flat = [0, *(world.object_id(name) for name in FLAT)]
    views = []
    for index in range(len(cameras)):
        view = scene.render(cameras, index)
        ids, depth = view.object_id, torch.from_numpy(view.depth)
        on_road = torch.from_numpy(np.isin(ids, road))
        hidden = torch.zeros_like(on_road)
        if above is not None:
            hidden[on_road] = ~seen_from(world, above, surface_points(cameras, index, depth)[on_road])
        foreground = torch.from_numpy(~np.isin(ids, flat))
        views.append(TrueView(torch.from_numpy(view.rgb), depth, on_road, foreground, hidden))
    return views


@dataclass(frozen=True)
class TrueTown:
    """Makes a renderer of the town behind a data set, as the drone saw it; small enough for another process."""

    description: Mapping
    origin: Float[Tensor, " 3"]
    """What loading the data set subtracted from all positions, metres."""

    def __call__(self) -> Callable[[Cameras, Sequence[int]], Iterator[tuple[np.ndarray, np.ndarray]]]:
        """Returns a function that gives colours (uint8 [h, w, 3]) and depth (m, along the axis, 0 where nothing is)."""
        scene = Scene(world_from_description(self.description), {})

        def render(cameras: Cameras, indices: Sequence[int]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
            pose = cameras.pose.clone()
            pose[:, :3, 3] += self.origin.to(pose)
            for index in indices:
                view = scene.render(replace(cameras, pose=pose), index)
                yield view.rgb, view.depth

        return render


def surface_points(cameras: Cameras, index: int, depth: Float[Tensor, "h w"]) -> Float[Tensor, "h w 3"]:
    """Returns the point (m, world) that each pixel of a camera sees at a depth along the optical axis."""
    rays = image_rays(cameras, index)
    forward = -cameras.pose[index, :3, 2]
    distance = depth.reshape(-1) / (rays.directions @ forward)
    return (rays.origins + rays.directions * distance[:, None]).view(*depth.shape, 3)


def seen_from(world: World, cameras: Cameras, points: Float[Tensor, "n 3"]) -> Bool[Tensor, " n"]:
    """Whether each point of a surface lies in some camera's picture with nothing in front of it."""
    seen = torch.zeros(len(points), dtype=torch.bool)
    size = torch.tensor([cameras.width, cameras.height])
    for index in range(len(cameras)):
        rows = (~seen).nonzero()[:, 0]
        pixel, _ = project(cameras, torch.full((len(rows),), index), points[rows])
        rows = rows[((pixel >= 0) & (pixel < size)).all(dim=1)]
        eye = cameras.pose[index, :3, 3]
        way = points[rows] - eye
        length = way.norm(dim=1)
        directions = np.ascontiguousarray((way / length[:, None]).numpy(), np.float32)
        origins = np.ascontiguousarray(eye.expand(len(rows), 3).numpy(), np.float32)
        hit, _ = world.stage.caster.cast(origins, directions)
        seen[rows] = torch.from_numpy(hit) > length - SURFACE
    return seen


@dataclass(frozen=True)
class ViewErrors:
    """How far rendered views are from the truth; None where no pixel counts."""

    psnr_db: float
    ssim: float
    road_psnr_db: float | None
    foreground_psnr_db: float | None
    road_depth_rmse_m: float | None
    hidden_road_psnr_db: float | None
    hidden_road_share: float


def view_errors(
    truth: list[TrueView], rgb: list[Float[Tensor, "h w 3"]], depth: list[Float[Tensor, "h w"]]
) -> ViewErrors:
    """Compares views with the truth; squared errors of road, foreground and depth are pooled over all pixels."""
    road, foreground, hidden, distances, whole, similar = [], [], [], [], [], []
    for true, colour, far in zip(truth, rgb, depth):
        target = true.rgb.float() / 255
        squared = (colour - target).square().mean(dim=-1)
        road.append(squared[true.road])
        foreground.append(squared[true.foreground])
        hidden.append(squared[true.hidden])
        near = true.road & (true.depth > 0) & (true.depth <= NEAR)
        error = (far - true.depth)[near]
        # nothing seen where the road is: as wrong as can be counted
        distances.append(torch.where(error.isfinite(), error, NEAR).square())
        whole.append(float(psnr(colour, target)))
        similar.append(float(ssim(colour, target)))
    return ViewErrors(
        float(np.mean(whole)),
        float(np.mean(similar)),
        _pooled_psnr(road),
        _pooled_psnr(foreground),
        _pooled_rmse(distances),
        _pooled_psnr(hidden),
        sum(map(len, hidden)) / max(sum(map(len, road)), 1),
    )


def axis_depth(cameras: Cameras, index: int, distance: Float[Tensor, " rays"]) -> Float[Tensor, "h w"]:
    """Returns the depth along the optical axis of distances along the rays of a camera."""
    forward = -cameras.pose[index, :3, 2]
    return (distance * (image_rays(cameras, index).directions @ forward)).view(cameras.height, cameras.width)


def _pooled_psnr(parts: list[Tensor]) -> float | None:
    values = torch.cat(parts)
    return float(-10 * torch.log10(values.mean().clamp(min=1e-10))) if len(values) else None


def _pooled_rmse(parts: list[Tensor]) -> float | None:
    values = torch.cat(parts)
    return float(values.mean().sqrt()) if len(values) else None
