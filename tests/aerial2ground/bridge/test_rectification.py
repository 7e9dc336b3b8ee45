"""What the device sees becomes what the policy was trained on: lines stay straight, the horizon is where it was."""

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from aerial2ground.bridge.car_file import CameraCalibration, load_car
from aerial2ground.bridge.rectification import Rectifier, policy_focal, turn
from aerial2ground.car_camera import CarCameraConfig, car_cameras
from aerial2ground.exported_policy import PolicyInfo
from hashnerf.cameras import Cameras, camera_rays
from hashnerf.errors import UserError

ROOT = Path(__file__).resolve().parents[3]
INFO = PolicyInfo(48, 27, 3, 0.4189, 100.0, -6.0)
FOCAL = 24 / math.tan(math.radians(50))
SAME = CameraCalibration(48, 27, FOCAL, FOCAL, 24.0, 13.5, pitch=-6.0)
WIDE = CameraCalibration(960, 720, 330.0, 335.0, 484.0, 355.0, pitch=-6.0)
BARREL = replace(WIDE, k1=-0.1, k2=0.008, p1=0.002, p2=-0.003)
NOISE = np.random.default_rng(0).integers(0, 256, (27, 48, 3), dtype=np.uint8)


def seen(lens: CameraCalibration, pattern) -> np.ndarray:
    """What a camera of the project's renderer sees of `pattern`, a function of the direction (car's axes) to 0..255."""
    config = CarCameraConfig(pitch=lens.pitch)
    pose = car_cameras(config, torch.zeros(1, 3)).pose
    camera = Cameras(
        pose,
        torch.tensor([[lens.fl_x, lens.fl_y]]),
        torch.tensor([[lens.cx, lens.cy]]),
        torch.tensor([[lens.k1, lens.k2, lens.p1, lens.p2]]),
        lens.width,
        lens.height,
    )
    rows, columns = torch.meshgrid(torch.arange(lens.height), torch.arange(lens.width), indexing="ij")
    pixels = torch.stack([columns, rows], dim=-1).reshape(-1, 2) + 0.5
    directions = camera_rays(camera, torch.zeros(len(pixels), dtype=torch.long), pixels).directions.double().numpy()
    grey = np.clip(pattern(directions), 0, 255).astype(np.uint8).reshape(lens.height, lens.width, 1)
    return np.repeat(grey, 3, axis=2)


def smooth_pattern(d: np.ndarray) -> np.ndarray:
    """Waves across and down that even 48 pixels can show."""
    across, up = d[:, 1] / d[:, 0], d[:, 2] / d[:, 0]
    return 127.5 + 60 * np.sin(4 * across + 0.3) + 60 * np.sin(5 * up + 1.0)


def pinhole(info: PolicyInfo) -> CameraCalibration:
    """The policy's camera, eight times as fine: its mean over 8 x 8 pixels is the truth."""
    focal = 8 * policy_focal(info)
    return CameraCalibration(
        8 * info.width, 8 * info.height, focal, focal, 4.0 * info.width, 4.0 * info.height, pitch=info.pitch
    )


def truth(info: PolicyInfo) -> np.ndarray:
    return cv2.resize(seen(pinhole(info), smooth_pattern), (info.width, info.height), interpolation=cv2.INTER_AREA)


def test_the_same_camera_passes_untouched():
    rectify = Rectifier(SAME, INFO)
    assert rectify.identity and rectify(NOISE) is NOISE
    assert Rectifier(load_car(ROOT / "configs/cars/mini_city.yaml").camera, INFO).identity


@pytest.mark.parametrize("change", [{"k1": 1e-3}, {"p2": 1e-3}, {"pitch": -6.5}, {"cx": 24.2}, {"fl_x": 20.0}])
def test_whatever_differs_is_mapped(change):
    assert not Rectifier(replace(SAME, **change), INFO).identity


def test_a_finer_camera_of_the_same_view_is_averaged():
    fine = CameraCalibration(144, 81, 3 * FOCAL, 3 * FOCAL, 72.0, 40.5, pitch=-6.0)
    picture = np.random.default_rng(1).integers(0, 256, (81, 144, 3), dtype=np.uint8)
    rectify = Rectifier(fine, INFO)
    assert rectify.multiple == 3
    assert np.array_equal(rectify(picture), cv2.resize(picture, (48, 27), interpolation=cv2.INTER_AREA))


@pytest.mark.parametrize("lens", [WIDE, BARREL, replace(WIDE, pitch=-2.0), replace(BARREL, pitch=-9.0)])
def test_it_is_what_the_policys_own_camera_would_see(lens):
    wanted = truth(INFO).astype(int)
    rectified = Rectifier(lens, INFO)(seen(lens, smooth_pattern)).astype(int)
    plain = cv2.resize(seen(lens, smooth_pattern), (48, 27), interpolation=cv2.INTER_AREA).astype(int)
    assert np.abs(rectified - wanted).max() <= 3
    assert np.abs(plain - wanted).max() > 20, "a pattern that does not tell cameras apart proves nothing"


@pytest.mark.parametrize("pitch", [-10.0, -6.0, 0.0, 4.0])
def test_the_horizon_lies_where_the_policys_pitch_puts_it(pitch):
    # a camera that looks down by 6 degrees has the horizon above its middle: 13.5 - f tan(6 degrees) = 11.38 rows down
    sky = seen(replace(WIDE, pitch=pitch), lambda d: np.where(d[:, 2] > 0, 255, 0))
    rectified = Rectifier(replace(WIDE, pitch=pitch), INFO)(sky)
    rows = rectified[:, 24, 0].astype(float).sum() / 255
    assert rows == pytest.approx(13.5 - FOCAL * math.tan(math.radians(6)), abs=0.1)


def test_the_turn_raises_the_forward_axis():
    # y points down: 90 degrees up is -y
    assert turn(90.0) @ [0, 0, 1] == pytest.approx([0, -1, 0])


@pytest.mark.parametrize("degrees, missing", [(80.0, 30), (90.0, 16), (95.0, 8)])
def test_too_narrow_cameras_are_refused(degrees, missing):
    # of the columns: 1 - tan(40) / tan(50) = 29.6 %; tan(45): 16.1 %; tan(47.5): 8.4 %; all rows are seen
    focal = 400 / math.tan(math.radians(degrees / 2))
    lens = CameraCalibration(800, 800, focal, focal, 400.0, 400.0, pitch=-6.0)
    said = rf"^{missing} % of the policy's picture \(100 degrees across, pitch -6\) .* \({degrees:g} degrees across"
    with pytest.raises(UserError, match=said):
        Rectifier(lens, INFO)


def test_a_camera_that_looks_elsewhere_is_refused():
    # it looks down to tan^-1(365 / 335) - 40 = 7.4 degrees below the horizon, the policy down to 39.8: about half
    with pytest.raises(UserError, match=r"^(4\d|5\d) % of the policy's picture"):
        Rectifier(replace(WIDE, pitch=40.0), INFO)
    with pytest.raises(UserError, match=r"^100 % of the policy's picture"):
        Rectifier(replace(WIDE, pitch=80.0), replace(INFO, pitch=-80.0))  # behind it, too


def test_a_border_that_is_hardly_missed_repeats_the_edge():
    # 0.8 % of the columns to either side of 1 - 1.016: under 2 %
    narrow = CameraCalibration(480, 288, 10 * FOCAL * 1.016, 10 * FOCAL * 1.016, 240.0, 144.0, pitch=-6.0)
    white = np.full((288, 480, 3), 255, np.uint8)
    assert (Rectifier(narrow, INFO)(white) == 255).all()
    with pytest.raises(UserError, match="3 % of the policy's picture"):
        Rectifier(replace(narrow, fl_x=10 * FOCAL * 1.03, fl_y=10 * FOCAL * 1.016), INFO)


def test_a_lens_that_folds_back_is_not_believed():
    # 1 + 3 k1 s = 0 at s = 1: beyond 45 degrees the formula bends directions back into the picture, and 50 are needed
    folding = replace(WIDE, k1=-1 / 3)
    with pytest.raises(UserError, match="% of the policy's picture"):
        Rectifier(folding, INFO)
    Rectifier(folding, replace(INFO, field_of_view=70.0))


def test_pictures_of_another_size_are_refused():
    for lens in (SAME, WIDE):
        with pytest.raises(UserError, match=rf"pictures of 64 x 36 pixels, but .* are {lens.width} x {lens.height}"):
            Rectifier(lens, INFO)(np.zeros((36, 64, 3), np.uint8))


def test_the_zed_of_the_f1tenth_file_sees_enough():
    lens = load_car(ROOT / "configs/cars/f1tenth.yaml").camera
    assert Rectifier(lens, INFO)(np.zeros((376, 672, 3), np.uint8)).shape == (27, 48, 3)


def test_of_two_eyes_side_by_side_the_left_one_is_used():
    both = np.concatenate([NOISE, 255 - NOISE], axis=1)
    two = replace(SAME, stereo=True)
    assert two.device_width == 96
    np.testing.assert_array_equal(Rectifier(two, INFO)(both), NOISE)
    with pytest.raises(UserError, match="two eyes side by side"):
        Rectifier(two, INFO)(NOISE)
    with pytest.raises(UserError, match="96 x 27"):
        Rectifier(SAME, INFO)(both)
