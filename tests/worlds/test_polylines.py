"""Lines on the ground against circles and hand-worked numbers."""

import math

import numpy as np
import pytest

from worlds.polylines import arc_lengths, beside, distance_to, normals, resampled, rounded

SQUARE = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)]


def test_rounded_corners_shorten_a_square_by_the_arcs():
    line = rounded(SQUARE, [1.0] * 4)
    assert np.array_equal(line[0], line[-1])
    # four straight pieces of 2 and a full circle of radius 1
    assert arc_lengths(line)[-1] == pytest.approx(8 + 2 * math.pi, abs=1e-3)
    corners = np.hypot(*(line - np.array([1.0, 1.0])).T)
    assert corners[(line < 1.0).all(axis=1)] == pytest.approx(1.0)


def test_the_other_direction_gives_the_same_line():
    there, back = rounded(SQUARE, [1.0] * 4), rounded(SQUARE[::-1], [1.0] * 4)
    assert distance_to(there, back).max() < 1e-3


def test_equal_pieces_keep_ends_and_length():
    line = resampled(np.array([(0.0, 0.0), (3.0, 0.0), (3.0, 1.0)]), 0.3)
    assert len(line) == 15 and line[0].tolist() == [0, 0] and line[-1].tolist() == [3, 1]
    assert resampled(np.array([(0.0, 0.0), (0.1, 0.0)]), 1.0).tolist() == [[0, 0], [0.1, 0]]


def test_left_of_a_circle_driven_counter_clockwise_is_inside():
    angle = np.linspace(0, 2 * math.pi, 721)
    circle = 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert np.hypot(*beside(circle, 0.5).T) == pytest.approx(1.5, abs=1e-4)
    assert np.hypot(*normals(circle).T) == pytest.approx(1.0)


def test_distances_by_hand():
    line = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0)])
    points = np.array([(1.0, 0.5), (-3.0, 4.0), (2.5, 1.0), (3.0, -1.0)])
    assert distance_to(line, points) == pytest.approx([0.5, 5.0, 0.5, math.sqrt(2)])
