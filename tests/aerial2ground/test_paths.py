"""Paths against a circle."""

import math

import numpy as np
import pytest

from aerial2ground.paths import Path
from hashnerf.errors import UserError

ANGLE = np.linspace(0, 2 * math.pi, 1441)
CIRCLE = Path(2 * np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1))
LINE = Path(np.array([(0.0, 0.0), (3.0, 0.0), (3.0, 4.0)]))


def test_a_circle():
    assert CIRCLE.closed and CIRCLE.length == pytest.approx(4 * math.pi, rel=1e-4)
    s = np.array([0.0, math.pi, 4 * math.pi, 5 * math.pi])
    assert CIRCLE.at(s) == pytest.approx(np.array([(2, 0), (0, 2), (2, 0), (0, 2)]), abs=1e-3)
    yaw = CIRCLE.poses(s)[:, 2]
    assert np.cos(yaw) == pytest.approx([0, -1, 0, -1], abs=0.01) and np.sin(yaw) == pytest.approx(
        [1, 0, 1, 0], abs=0.01
    )


def test_an_open_path_ends_at_its_ends():
    assert not LINE.closed and LINE.length == 7.0
    assert LINE.at(np.array([-1.0, 3.0, 5.0, 99.0])).tolist() == [[0, 0], [3, 0], [3, 2], [3, 4]]
    assert LINE.poses(np.array([0.0, 7.0]))[:, 2] == pytest.approx([0.0, math.pi / 2])


def test_the_nearest_place_and_the_side():
    assert CIRCLE.nearest(np.array([0.0, 1.5])) == pytest.approx((math.pi, 0.5), abs=2e-3), "inside is left"
    assert CIRCLE.nearest(np.array([0.0, 2.25])) == pytest.approx((math.pi, -0.25), abs=2e-3)
    assert LINE.nearest(np.array([1.0, 0.5])) == (1.0, 0.5)


@pytest.mark.parametrize("points", [[], [(0.0, 0.0)], [(1.0, 1.0), (1.0, 1.0)], [(0.0, 0.0), (math.nan, 1.0)]])
def test_n98_no_path(numeric_row, points):
    with pytest.raises(UserError, match="a path") as refused:
        Path(np.array(points).reshape(-1, 2))
    numeric_row("N98", f"{points}: taken for a path", refused is None)
