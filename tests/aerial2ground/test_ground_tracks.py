"""Pictures laid onto the ground, and points followed between them."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from aerial2ground.bundle_adjustment import Bundle, errors, triangulated
from aerial2ground.ground_tracks import Raster, laid_on_ground, track_ground
from tests.aerial2ground.textured_ground import BOX, PIXEL, cameras, flight, photograph, texture
from worlds.drone_survey import disturbed


def pictures(seen):
    return np.stack([photograph(seen, index) for index in range(len(seen))])


def test_a_raster_has_the_pictures_pixels_and_covers_the_box():
    raster = Raster.over(cameras(flight()), BOX, 0.0)
    assert raster.pixel == pytest.approx(1.6 / 120, rel=0.15)
    assert raster.columns * raster.pixel == pytest.approx(4.0, abs=raster.pixel)
    far = replace(cameras(flight()), focal=torch.full((12, 2), 1e9))
    assert Raster.over(far, BOX, 0.0).columns <= 8192


@pytest.mark.parametrize("index", [0, 1])
def test_the_true_pose_lays_the_ground_where_it_is(index):
    seen = cameras(flight())
    raster = Raster((0.0, 0.0), PIXEL, 400, 400, 0.0)
    laid = laid_on_ground(photograph(seen, index), seen, index, raster)
    assert laid is not None
    rows, columns = np.nonzero(laid.valid)
    assert len(rows) > 5000
    # a square is sampled at its corner, between the middles of four squares of the texture
    between = cv2.blur(texture(), (2, 2), anchor=(1, 1))[laid.row + rows, laid.column + columns]
    assert np.abs(laid.grey[rows, columns] - between).mean() < 3.0
    assert np.corrcoef(laid.grey[rows, columns], between)[0, 1] > 0.995


def test_a_picture_of_the_sky_shows_no_ground():
    up = flight()[:1].clone()
    up[0, :3, 1:3] *= -1
    seen = cameras(up)
    assert laid_on_ground(np.zeros((120, 160, 3), np.uint8), seen, 0, Raster.over(seen, BOX, 0.0)) is None


def test_followed_points_are_where_the_true_cameras_see_them():
    poses = flight()
    rng = np.random.default_rng(2)
    told = torch.stack([disturbed(pose, 0.02, 1.0, rng) for pose in poses])
    shown = pictures(cameras(poses))
    seen = track_ground(shown, cameras(told), Raster.over(cameras(told), BOX, 0.0), 40, np.full(len(shown), 2))
    assert len(seen.point) > 1000 and np.bincount(seen.point).min() >= 3
    pose = poses.double().numpy()
    rotation, position = pose[:, :3, :3], pose[:, :3, 3]
    truth = Bundle(rotation, position, triangulated(rotation, position, seen))
    # the points of the ground come out of the true poses flat, and their rays meet
    assert np.median(np.abs(truth.points[:, 2])) < 0.01
    off = np.linalg.norm(errors(truth, seen)[0], axis=1) * 120
    assert np.median(off) < 0.25 and (off < 1.0).mean() > 0.95


def test_black_pictures_have_no_points():
    seen = cameras(flight())
    none = track_ground(np.zeros((12, 120, 160, 3), np.uint8), seen, Raster.over(seen, BOX, 0.0), 40, np.full(12, 2))
    assert none.points == 0 and not math.isnan(float(none.place.sum()))
