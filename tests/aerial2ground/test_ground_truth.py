"""The truth from the ground, and distances from it."""

import math
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch

from aerial2ground.car_camera import CarCameraConfig, car_cameras
from aerial2ground.ground_truth import NEAR, TrueTown, axis_depth, seen_from, true_views, view_errors
from hashnerf.cameras import Cameras, look_at
from worlds.mini_city import MiniCityConfig, build_mini_city

TOWN = build_mini_city(MiniCityConfig(), 0)
CAMERAS = car_cameras(
    CarCameraConfig(width=32, height=18), torch.tensor([[1.9, 0.575, 0.0], [3.175, 2.0, math.pi / 2]])
)
VIEWS = true_views(TOWN, CAMERAS)


def test_a_true_town_is_rendered_where_loading_moved_it():
    origin = torch.tensor([1.0, -2.0, 0.5])
    moved = replace(CAMERAS, pose=CAMERAS.pose.clone())
    moved.pose[:, :3, 3] -= origin
    render = TrueTown({"scenario": "mini_city", "seed": 0, "config": asdict(MiniCityConfig())}, origin)()
    for (rgb, depth), view in zip(render(moved, range(len(VIEWS))), VIEWS, strict=True):
        assert (np.abs(rgb.astype(int) - view.rgb.numpy()) > 2).mean() < 0.02, "but for rounding at edges"
        assert np.isclose(depth, view.depth.numpy(), atol=1e-3).mean() > 0.98


def test_hidden_road_is_what_lies_under_a_crown():
    town = build_mini_city(MiniCityConfig(avenue=20), 0)
    down = look_at(torch.tensor([2.0, 0.75, 2.4]), torch.tensor([2.0, 0.751, 0.0]), torch.tensor([0.0, 1.0, 0.0]))
    above = Cameras(down[None], torch.full((1, 2), 60.0), torch.full((1, 2), 40.0), torch.zeros(1, 4), 80, 80)
    points = torch.tensor([[2.0 + 0.1 * i, 0.75, 0.0] for i in range(-6, 7)])
    seen = seen_from(town, above, points)
    # straight down: what hides a point is what a ray up from it meets
    eye = above.pose[0, :3, 3]
    way = torch.nn.functional.normalize(eye - points, dim=1)
    origins = (points + 1e-3 * way).numpy()
    expected = [np.isinf(town.stage.caster.cast(origins[i : i + 1], way[i : i + 1].numpy())[0][0]) for i in range(13)]
    assert seen.tolist() == expected and 0 < sum(expected) < 13
    assert not seen_from(town, above, torch.tensor([[5.2, 4.0, 0.0]])).any(), "outside the picture"


def test_only_road_is_hidden_and_its_error_counts_alone():
    town = build_mini_city(MiniCityConfig(avenue=60), 0)
    cameras = car_cameras(CarCameraConfig(width=32, height=18), torch.tensor([[2.0, 0.575, 0.0]]))
    view = true_views(town, cameras, town.rig.cameras.select([0, 60]))[0]
    assert view.hidden.any() and not (view.hidden & ~view.road).any()
    wrong = torch.where(view.hidden[..., None], 1.0, 0.0) * 0.1 + view.rgb.float() / 255
    errors = view_errors([view], [wrong], [view.depth])
    assert errors.hidden_road_psnr_db == pytest.approx(20.0, abs=0.01)
    assert errors.hidden_road_share == pytest.approx(float(view.hidden.sum() / view.road.sum()))
    assert VIEWS[0].hidden.sum() == 0 and view_errors(VIEWS, *moved(0.0)).hidden_road_psnr_db is None


def moved(by: float):
    rgb = [(view.rgb.float() / 255 + by).clamp(0, 1) for view in VIEWS]
    return rgb, [view.depth + by for view in VIEWS]


def test_the_road_lies_below_and_houses_stand():
    for view in VIEWS:
        assert view.road[-1].float().mean() > 0.9 and not view.road[0].any()
        assert not (view.road & view.foreground).any()
    assert VIEWS[1].foreground.any()


def test_the_truth_has_no_error_in_depth():
    errors = view_errors(VIEWS, *moved(0.0))
    assert errors.road_depth_rmse_m == 0.0 and errors.ssim == pytest.approx(1.0)
    assert errors.road_psnr_db == pytest.approx(100.0)


def test_a_constant_error_is_found_in_every_part():
    errors = view_errors(VIEWS, *moved(0.01))
    assert errors.road_depth_rmse_m == pytest.approx(0.01, rel=1e-3)
    assert errors.road_psnr_db == pytest.approx(40.0, abs=0.1)
    assert errors.foreground_psnr_db == pytest.approx(40.0, abs=0.5)


def test_a_missing_road_counts_as_far_off():
    rgb, depth = moved(0.0)
    depth = [torch.full_like(one, torch.inf) for one in depth]
    found = view_errors(VIEWS, rgb, depth).road_depth_rmse_m
    assert found == NEAR


def test_depth_is_along_the_axis():
    depth = axis_depth(CAMERAS, 0, torch.ones(32 * 18))
    assert float(depth[9, 16]) == pytest.approx(1.0, abs=0.01)
    corner = math.sqrt((15.5 / CAMERAS.focal[0, 0]) ** 2 + (8.5 / CAMERAS.focal[0, 0]) ** 2 + 1)
    assert float(depth[0, 0]) == pytest.approx(1 / corner, abs=1e-4)


def test_the_truth_is_the_towns_own_render():
    assert VIEWS[0].depth[VIEWS[0].road].max() < 8 and np.isfinite(VIEWS[0].depth.numpy()).all()
