"""The OPENCV lens against OpenCV itself, its inverse, its fold, and the keys it is read from."""

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hashnerf.lens import _jacobian, distort, largest_radius, read_lens, undistort

PIXEL = 1 / 500  # one pixel of a camera with focal length 500, in normalised units


def _repeat(coefficients, count):
    return torch.tensor(coefficients, dtype=torch.float64).expand(count, 4)


def test_distortion_worked_by_hand():
    # x = .5, y = 1: r2 = 1.25, radial = 1 + .1*1.25 + .01*1.5625 = 1.140625
    # x' = .5*1.140625 + 2*.001*.5 + .002*(1.25 + .5)   = .5703125 + .001 + .0035   = .5748125
    # y' = 1.140625 + .001*(1.25 + 2) + 2*.002*.5       = 1.140625 + .00325 + .002  = 1.145875
    result = distort(torch.tensor([[0.5, 1.0]], dtype=torch.float64), _repeat([0.1, 0.01, 0.001, 0.002], 1))
    torch.testing.assert_close(result, torch.tensor([[0.5748125, 1.145875]], dtype=torch.float64))


def test_distortion_agrees_with_opencv():
    points = torch.rand(200, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) * 1.6 - 0.8
    coefficients = [-0.12, 0.03, 0.004, -0.002]
    in_space = np.concatenate([points.numpy(), np.ones((200, 1))], axis=1)
    expected, _ = cv2.projectPoints(in_space, np.zeros(3), np.zeros(3), np.eye(3), np.array(coefficients))
    np.testing.assert_allclose(distort(points, _repeat(coefficients, 200)), expected[:, 0], atol=1e-12)


@pytest.mark.parametrize("k1, k2", [(-0.1, 0.0), (-0.35, 0.15), (0.5, 0.2), (0.0, 0.0), (-0.014, 0.0026)])
def test_n120_undistortion_reaches_a_millionth_of_a_pixel_at_the_corners(numeric_row, k1, k2):
    corners = torch.tensor([[0.64, 0.48], [-0.64, 0.48], [0.0, 0.48], [0.0, 0.0]], dtype=torch.float64)
    lens = _repeat([k1, k2, 0.001, -0.002], 4)
    ideal, good = undistort(corners, lens, torch.full((4,), 1e-6 * PIXEL, dtype=torch.float64))
    assert good.all()
    off = float((distort(ideal, lens) - corners).abs().max()) / PIXEL
    numeric_row("N120", f"corners of a wide picture, k1 = {k1:g}, k2 = {k2:g}: pixels", off, 1e-6)


def test_n120_undistortion_masks_what_a_folding_lens_cannot_show(numeric_row):
    # k1 = -.6: r(1 - .6 r^2) grows up to r = 1/sqrt(1.8) = .745 where it is .497; radius .8 has no preimage.
    points = torch.tensor([[0.64, 0.48], [0.4, 0.2], [torch.nan, 0.0]], dtype=torch.float64)
    ideal, good = undistort(points, _repeat([-0.6, 0, 0, 0], 3), torch.full((3,), 1e-9, dtype=torch.float64))
    wrong = sum(one != wanted for one, wanted in zip(good.tolist(), [False, True, False]))
    numeric_row("N120", "k1 = -0.6: points beyond the fold that are not masked", wrong)
    assert float(ideal[1].norm()) < 0.745


def test_undistortion_refuses_the_far_side_of_the_fold():
    # k1 = -.6: .4 is reached at r = .5 (.5 - .6*.125 = .425 > .4) and again on the far side; only the near one counts.
    ideal, good = undistort(
        torch.tensor([[0.4, 0.0]], dtype=torch.float64), _repeat([-0.6, 0, 0, 0], 1), torch.tensor([1e-12]).double()
    )
    roots = np.roots([-0.6, 0, 1, -0.4])
    assert good.item() and float(ideal[0, 0]) == pytest.approx(min(root.real for root in roots if root.real > 0))


def test_undistortion_does_not_start_at_the_fold():
    # k1 > 0 > k2: the point at radius 1.07 is seen at 1.517, right at the fold (1.518), where Newton's slope is zero.
    lens = _repeat([0.58099, -0.18904, 0.0, 0.0], 1)
    point = torch.tensor([[0.0, 1.07]], dtype=torch.float64)
    assert float(distort(point, lens).norm()) == pytest.approx(float(largest_radius(lens)), abs=1e-2)
    ideal, good = undistort(distort(point, lens), lens, torch.tensor([1e-6 * PIXEL], dtype=torch.float64))
    assert good.item()
    torch.testing.assert_close(ideal, point, atol=1e-9, rtol=0)


def test_a_root_where_the_picture_is_turned_inside_out_is_masked():
    # An absurd tangential distortion has no root near the image; Newton finds one at radius 3.4, mirrored.
    lens = _repeat([0.28506843027891415, -0.007461782244459536, 0.05874066477103013, -0.30077877723435686], 1)
    point = torch.tensor([[0.5049267577822076, -0.3659283742637527]], dtype=torch.float64)
    ideal, good = undistort(point, lens, torch.tensor([2e-9], dtype=torch.float64))
    torch.testing.assert_close(distort(ideal, lens), point)
    assert not good.item()


def test_newton_uses_the_exact_jacobian():
    points = torch.tensor([[0.3, -0.7], [-0.5, 0.2]], dtype=torch.float64)
    lens = _repeat([-0.1, 0.02, 0.03, -0.04], 2)
    full = torch.autograd.functional.jacobian(lambda p: distort(p, lens).sum(0), points)  # [out, n, in]
    xx, xy, yy = _jacobian(points, lens)
    torch.testing.assert_close(torch.stack([torch.stack([xx, xy], -1), torch.stack([xy, yy], -1)]), full)


@settings(max_examples=150, deadline=None)
@given(
    st.floats(-0.5, 0.5),
    st.floats(-0.2, 0.3),
    st.floats(-0.01, 0.01),
    st.floats(-0.01, 0.01),
    st.floats(0, 0.9),
    st.floats(0, 6.28),
)
def test_undistort_inverts_distort_on_the_monotone_side(k1, k2, p1, p2, share, angle):
    lens = _repeat([k1, k2, p1, p2], 1)
    radius = share * min(float(largest_radius(lens)), 1.2)
    point = radius * torch.tensor([[np.cos(angle), np.sin(angle)]], dtype=torch.float64)
    ideal, good = undistort(distort(point, lens), lens, torch.tensor([1e-6 * PIXEL], dtype=torch.float64))
    assert good.item()
    torch.testing.assert_close(ideal, point, atol=1e-7, rtol=0)


@pytest.mark.parametrize(
    "k1, k2, expected",
    [
        (0.0, 0.0, np.inf),
        (0.5, 0.2, np.inf),
        (-0.35, 0.15, np.inf),  # 1 - 1.05 s + .75 s^2 has no real root: 1.1025 < 3
        (-0.6, 0.0, 1.8**-0.5),  # 1 - 1.8 s = 0
        (0.0, -0.2, 1.0),  # 1 - s^2 = 0
        (-1.0, 0.4, 0.5**0.5 * (3 - 1) ** 0.5 / 2**0.5),  # 1 - 3 s + 2 s^2 = (1 - s)(1 - 2 s): s = 1/2
    ],
)
def test_largest_radius_is_the_first_root_of_the_slope(k1, k2, expected):
    result = largest_radius(torch.tensor([[k1, k2, 0.0, 0.0]], dtype=torch.float64))
    assert float(result) == pytest.approx(expected)


def test_a_pinhole_is_read_with_its_defaults():
    # f = w / (2 tan(angle / 2)): 90 degrees and 640 pixels give 320. Centre (w/2, h/2), square pixels, no distortion.
    lens, problems = read_lens({"camera_angle_x": np.pi / 2}, 640, 480)
    assert problems == [] and lens == pytest.approx([320, 320, 320, 240, 0, 0, 0, 0])


def test_stated_numbers_win_over_the_field_of_view():
    keys = {"camera_angle_x": 1.0, "fl_x": 500, "fl_y": 510, "cx": 300.5, "cy": 200, "k1": -0.1, "p2": 0.001}
    assert read_lens(keys, 640, 480) == ([500, 510, 300.5, 200, -0.1, 0, 0, 0.001], [])


@pytest.mark.parametrize(
    "keys, sentence",
    [
        ({"fl_x": 0}, "fl_x = 0 must be above zero"),
        ({"fl_x": -1}, "fl_x = -1 must be above zero"),
        ({"fl_x": 500, "fl_y": -2}, "fl_y = -2 must be above zero"),
        ({"fl_x": 0.69}, "fl_x = 0.69 pixels is a view of over 170 degrees"),
        ({"fl_x": float("nan")}, "fl_x = nan is not a finite number"),
        ({"fl_x": "500"}, "fl_x = 500 is not a finite number"),
        ({"fl_x": True}, "fl_x = True is not a finite number"),
        ({"fl_x": 10**400}, "is not a finite number"),
        ({}, "neither fl_x (pixels) nor camera_angle_x (radians)"),
        ({"camera_angle_x": 60}, "camera_angle_x = 60 must be in radians"),
        ({"camera_angle_x": 0}, "camera_angle_x = 0 must be in radians"),
        ({"fl_x": 500, "cx": 1e4}, "cx = 10000 lies outside the image of 640x480"),
        ({"fl_x": 500, "cy": -1}, "cy = -1 lies outside the image"),
        ({"fl_x": 500, "k3": 0.1}, "k3 and k4 are not part of the OPENCV lens"),
        ({"fl_x": 500, "camera_model": "OPENCV_FISHEYE"}, "camera_model 'OPENCV_FISHEYE' is not supported"),
        ({"fl_x": 500, "camera_model": ["x"]}, "is not supported"),
        ({"fl_x": 500, "k1": -0.6}, "folds back inside the image: it can be inverted up to the radius 0.745"),
    ],
)
def test_n120_n121_a_bad_lens_is_named(numeric_row, keys, sentence):
    lens, problems = read_lens(keys, 640, 480)
    row = "N120" if any(key.startswith("k") for key in keys) else "N121"
    numeric_row(row, f"{keys}: taken in", lens != [] or not any(sentence in problem for problem in problems))


def test_a_folding_lens_is_accepted_where_the_image_stays_inside():
    # With fl_x = 2000 the corner radius is 400/2000 = .2, far below the fold at .497.
    assert read_lens({"fl_x": 2000, "k1": -0.6}, 640, 480)[1] == []
