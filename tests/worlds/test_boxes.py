import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from worlds.boxes import Box, Pose, box_at, wrap_angle


def test_n91_n92_wrap_angle(numeric_row):
    assert wrap_angle(-math.pi) == math.pi
    wanted = {1e4 * 2 * math.pi + 0.3: 0.3, -1e4 * 2 * math.pi - 0.3: -0.3, 0.0: 0.0, 2 * math.pi: 0.0}
    # 1e8 less 15,915,494 turns, in 50 digits
    wanted[1e8] = 1.9426951345040145
    off = max(abs(wrap_angle(angle) - exact) for angle, exact in wanted.items())
    numeric_row("N91", "0.3 after 10,000 turns either way, 0, 2 pi and 1e8", off, 1e-6)
    half = [math.pi, float(np.float32(math.pi)), math.nextafter(math.pi, 4), math.nextafter(math.pi, 0), 3 * math.pi]
    outside = sum(not -math.pi < wrap_angle(sign * angle) <= math.pi for angle in half for sign in (1, -1))
    numeric_row("N92", "pi of both precisions, its neighbours and 3 pi, both signs: outside (-pi, pi]", outside)
    assert wrap_angle(3 * math.pi / 2) == pytest.approx(-math.pi / 2)
    assert wrap_angle(0.3) == pytest.approx(0.3)


@given(st.floats(-1e9, 1e9))
def test_a_wrapped_angle_points_the_same_way(angle):
    wrapped = wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped - angle) == pytest.approx(1.0, abs=1e-9)


def test_box_stands_on_its_pose():
    box = box_at(Pose(1.0, 2.0, 0.5, math.pi / 2), (4.0, 2.0, 3.0))
    assert box.center == (1.0, 2.0, 2.0)
    np.testing.assert_allclose(sorted(map(tuple, box.corners())), [(0, 0), (0, 4), (2, 0), (2, 4)], atol=1e-12)


def test_distance_and_containment():
    box = Box((0.0, 0.0, 1.0), (4.0, 2.0, 2.0), math.pi / 2)  # 2 m along x, 4 m along y
    points = np.array([[0.0, 1.9, 1.0], [0.9, 0.0, 0.1], [1.5, 0.0, 1.0], [1.3, 2.4, 1.0], [0.0, 0.0, 5.0]])
    np.testing.assert_allclose(box.distance(points), [0, 0, 0.5, 0.5, 3.0], atol=1e-12)
    assert box.contains(points).tolist() == [True, True, False, False, False]


def test_overlap_by_hand():
    one = Box((0.0, 0.0, 0.0), (4.0, 2.0, 1.0), 0.0)
    assert not one.overlaps(Box((4.0, 0.0, 0.0), (4.0, 2.0, 1.0), 0.0))  # they touch
    assert one.overlaps(Box((3.9, 0.0, 0.0), (4.0, 2.0, 1.0), 0.0))
    # A diamond of half diagonal sqrt 2 at x = 3.5 reaches x = 2.09; at 3.3 it reaches 1.89.
    assert not one.overlaps(Box((3.5, 0.0, 0.0), (2.0, 2.0, 1.0), math.pi / 4))
    assert one.overlaps(Box((3.3, 0.0, 0.0), (2.0, 2.0, 1.0), math.pi / 4))


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-4, 4), st.floats(-4, 4))
def test_overlap_agrees_with_sampling(x, y, yaw, other_yaw):
    one, two = Box((0.0, 0.0, 0.0), (3.0, 1.5, 1.0), yaw), Box((x, y, 0.0), (2.0, 1.0, 1.0), other_yaw)
    grid = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 41), np.linspace(-0.5, 0.5, 41)), -1).reshape(-1, 2) * [2.0, 1.0]
    turn = np.array([[math.cos(other_yaw), math.sin(other_yaw)], [-math.sin(other_yaw), math.cos(other_yaw)]])
    points = np.column_stack([grid @ turn + [x, y], np.zeros(len(grid))])
    inside = one.contains(points * [1, 1, 1]).any()
    assert one.overlaps(two) == two.overlaps(one)
    if inside and one.distance(points).min() == 0:
        shrunk = Box(one.center, (2.98, 1.48, 1.0), yaw)
        assert one.overlaps(two) or not shrunk.contains(points).any()
    if one.overlaps(two):
        assert one.distance(points).min() < 0.06
