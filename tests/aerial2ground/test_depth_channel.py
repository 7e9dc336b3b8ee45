"""Depth in eight bits: numbers by hand, and what nothing looks like."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aerial2ground.depth_channel import depth_channel, with_depth


def test_numbers_by_hand():
    # 255 * 1 / 4 = 63.75, 255 * 2 / 4 = 127.5 (to even), at the range and beyond it 255
    depth = np.array([[1.0, 2.0, 3.999, 4.0, 100.0]])
    assert depth_channel(depth, 4.0).tolist() == [[64, 128, 255, 255, 255]]


@pytest.mark.filterwarnings("error")
def test_nothing_is_as_far_as_can_be():
    depth = np.array([0.0, -1.0, np.nan, np.inf, -np.inf, 1e-9, 1e30])
    assert depth_channel(depth, 4.0).tolist() == [255, 255, 255, 255, 255, 0, 255]


@given(st.floats(0.01, 65.0), st.floats(0.5, 65.0))
def test_within_the_range_half_a_step_is_lost(metres, depth_range):
    code = int(depth_channel(np.array([metres]), depth_range)[0])
    assert abs(code / 255 * depth_range - min(metres, depth_range)) <= depth_range / 510 * (1 + 1e-9)


def test_colours_stay_as_they_are():
    rgb = np.random.default_rng(0).integers(0, 256, (2, 3, 5, 3), dtype=np.uint8)
    both = with_depth(rgb, np.full((2, 3, 5), 0.4, np.float32), 4.0)
    assert np.array_equal(both[..., :3], rgb) and (both[..., 3] == 26).all() and both.dtype == np.uint8
