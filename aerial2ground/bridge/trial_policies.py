"""Policy files whose answer is known beforehand: what the bridge is tried with, in tests and by the evidence."""

from pathlib import Path
from typing import Literal, get_args

import numpy as np

from aerial2ground.exported_policy import COLOUR_ORDERS, PolicyInfo
from hashnerf.errors import UserError

Kind = Literal["constant", "brightness", "nan_when_black", "slow"]
OPSET, IR_VERSION = 17, 8
"""As `aerial2ground.policy_export`, which needs torch."""
SIDE = 512
"""Of the matrices that a slow policy multiplies."""


def trial_policy(
    path: Path,
    kind: Kind,
    width: int,
    height: int,
    value: float = 0.1,
    *,
    channels: int = 3,
    steering_limit: float = 0.4189,
    field_of_view: float = 100.0,
    pitch: float = -6.0,
    products: int = 40,
) -> Path:
    """Writes a policy file for pictures of `width` x `height` pixels and returns its path.

    constant: answers `value` (rad), whatever it sees.
    brightness: `value` times the picture's mean over 255; black is 0, white is `value`.
    nan_when_black: as constant, but not a number for a picture that is all black.
    slow: as constant, after `products` matrix products of `SIDE` (about a quarter of a GFLOP each).

    Raises UserError where the extra `export` is missing.
    """
    assert kind in get_args(Kind)
    try:
        from onnx import TensorProto, checker, helper, numpy_helper
    except ImportError as error:
        raise UserError("writing policies needs the extra `export`: pip install -e .[export]") from error
    depth = 4.0 if channels == 4 else 0.0
    order = COLOUR_ORDERS[channels]
    info = PolicyInfo(width, height, channels, steering_limit, field_of_view, pitch, depth, "trial", colour_order=order)
    numbers = {"value": np.array([[value]]), "full": np.array(255.0), "none": np.array(0.0), "one": np.array(1.0)}
    weights = [numpy_helper.from_array(np.asarray(number, np.float32), name) for name, number in numbers.items()]
    node = helper.make_node
    nodes = [
        node("Cast", ["picture"], ["numbers"], to=TensorProto.FLOAT),
        node("ReduceMean", ["numbers"], ["mean"], axes=[1, 2, 3], keepdims=0),
    ]
    if kind == "brightness":
        nodes += [node("Div", ["mean", "full"], ["share"])]
    elif kind == "nan_when_black":
        nodes += [node("Div", ["mean", "mean"], ["share"])]  # 0 / 0
    else:
        nodes += [node("Mul", ["mean", "none"], ["zero"])]
        last = "zero"
        if kind == "slow":
            weights.append(numpy_helper.from_array(np.array([SIDE, SIDE], np.int64), "square"))
            nodes += [node("Expand", ["zero", "square"], ["product_0"])]
            for number in range(products):  # each needs the one before it: none can be left out
                nodes += [node("MatMul", [f"product_{number}", "product_0"], [f"product_{number + 1}"])]
            nodes += [node("ReduceMean", [f"product_{products}"], ["nothing"], axes=[0, 1], keepdims=0)]
            last = "nothing"
        nodes += [node("Add", [last, "one"], ["share"])]
    nodes += [node("Mul", ["value", "share"], ["steering"])]
    picture = helper.make_tensor_value_info("picture", TensorProto.UINT8, [1, *info.shape])
    steering = helper.make_tensor_value_info("steering", TensorProto.FLOAT, [1, 1])
    graph = helper.make_graph(nodes, "trial", [picture], [steering], weights)
    opset = helper.make_opsetid("", OPSET)
    model = helper.make_model(graph, opset_imports=[opset], ir_version=IR_VERSION, producer_name="aerial2ground")
    helper.set_model_props(model, info.as_metadata())
    checker.check_model(model, full_check=True)
    path.write_bytes(model.SerializeToString(deterministic=True))
    return path
