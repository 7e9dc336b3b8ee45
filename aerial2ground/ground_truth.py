"""What the embedded town really looks like from the ground, and how far views of a radiance field are from that.

*Road* pixels show asphalt, markings or pavement; *foreground* pixels show anything that stands (houses, trees, cars):
a constant sky, and a lawn of one green, would flatter the mean over whole pictures. Depth is along the optical axis.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from hashnerf.cameras import Cameras, image_rays
from hashnerf.metrics import psnr, ssim
from worlds.scene import Scene, World

ROAD = ("road", "markings", "pavement")
FLAT = (*ROAD, "floor", "lawn")
NEAR = 2.0
"""Metres up to which the road's depth is judged."""


@dataclass(frozen=True)
class TrueView:
    """One camera's picture with masks."""

    rgb: UInt8[Tensor, "h w 3"]
    depth: Float[Tensor, "h w"]
    road: Bool[Tensor, "h w"]
    foreground: Bool[Tensor, "h w"]


def true_views(world: World, cameras: Cameras) -> list[TrueView]:
    """Renders the town from every camera."""
    scene = Scene(world, {})
    road = [world.object_id(name) for name in ROAD]
    flat = [0, *(world.object_id(name) for name in FLAT)]
    views = []
    for index in range(len(cameras)):
        view = scene.render(cameras, index)
        ids = view.object_id
        views.append(
            TrueView(
                torch.from_numpy(view.rgb),
                torch.from_numpy(view.depth),
                torch.from_numpy(np.isin(ids, road)),
                torch.from_numpy(~np.isin(ids, flat)),
            )
        )
    return views


@dataclass(frozen=True)
class ViewErrors:
    """How far rendered views are from the truth; None where no pixel counts."""

    psnr_db: float
    ssim: float
    road_psnr_db: float | None
    foreground_psnr_db: float | None
    road_depth_rmse_m: float | None


def view_errors(
    truth: list[TrueView], rgb: list[Float[Tensor, "h w 3"]], depth: list[Float[Tensor, "h w"]]
) -> ViewErrors:
    """Compares views with the truth; squared errors of road, foreground and depth are pooled over all pixels."""
    road, foreground, distances, whole, similar = [], [], [], [], []
    for true, colour, far in zip(truth, rgb, depth):
        target = true.rgb.float() / 255
        squared = (colour - target).square().mean(dim=-1)
        road.append(squared[true.road])
        foreground.append(squared[true.foreground])
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
