"""Trial policies answer what they promise."""

import math

import numpy as np
import pytest

from aerial2ground.exported_policy import load_exported
from hashnerf.errors import UserError

BLACK, GREY, WHITE = (np.full((9, 16, 3), level, np.uint8) for level in (0, 51, 255))


def test_constant(onnx_policy):
    policy = load_exported(onnx_policy("constant", 16, 9, -0.2))
    assert [policy(one) for one in (BLACK, GREY, WHITE)] == pytest.approx([-0.2] * 3, abs=1e-7)
    assert policy.info.shape == (9, 16, 3) and (policy.info.field_of_view, policy.info.pitch) == (100.0, -6.0)


def test_brightness(onnx_policy):
    policy = load_exported(onnx_policy("brightness", 16, 9, 0.3))
    # 51 / 255 = 0.2 of 0.3
    assert [policy(one) for one in (BLACK, GREY, WHITE)] == pytest.approx([0.0, 0.06, 0.3], abs=1e-7)


def test_black_is_no_number(onnx_policy):
    policy = load_exported(onnx_policy("nan_when_black", 16, 9, 0.1))
    assert [policy(one) for one in (GREY, WHITE)] == pytest.approx([0.1, 0.1], abs=1e-7)
    with pytest.raises(UserError, match="answers nan"):
        policy(BLACK)


def test_slow_works_longer_the_more_it_multiplies(onnx_policy):
    policy = load_exported(onnx_policy("slow", 16, 9, 0.1, products=2))
    assert math.isclose(policy(WHITE), 0.1, abs_tol=1e-7) and math.isclose(policy(BLACK), 0.1, abs_tol=1e-7)
    names = [node.op_type for node in _nodes(onnx_policy("slow", 16, 9, 0.1, products=5))]
    assert names.count("MatMul") == 5


def test_depth_and_other_cameras(onnx_policy):
    info = load_exported(onnx_policy("constant", 16, 9, channels=4, steering_limit=0.3, pitch=2.0)).info
    assert (info.shape, info.steering_limit, info.pitch, info.depth_range) == ((9, 16, 4), 0.3, 2.0, 4.0)


def _nodes(path):
    import onnx

    return onnx.load(path).graph.node
