"""The truth from the ground, and distances from it."""

import math

import numpy as np
import pytest
import torch

from aerial2ground.car_camera import CarCameraConfig, car_cameras
from aerial2ground.ground_truth import NEAR, axis_depth, true_views, view_errors
from worlds.mini_city import MiniCityConfig, build_mini_city

TOWN = build_mini_city(MiniCityConfig(), 0)
CAMERAS = car_cameras(
    CarCameraConfig(width=32, height=18), torch.tensor([[1.9, 0.575, 0.0], [3.175, 2.0, math.pi / 2]])
)
VIEWS = true_views(TOWN, CAMERAS)


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
