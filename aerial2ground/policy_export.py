"""A trained steering network becomes one self-contained ONNX file, which is tried against torch before it is written.

The graph: uint8 [1, h, w, c] -> float -> [1, c, h, w] / 255 - 0.5 -> convolutions, their batch normalisation folded in
-> fully connected layers -> times the steering limit -> `steering` [1, 1] in radians. Weights are float32. It is put
together layer by layer rather than traced: its operators do not depend on the version of an exporter.
"""

from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import torch
from jaxtyping import UInt8
from torch import nn

from aerial2ground.car_camera import CarCameraConfig
from aerial2ground.config import AerialConfig
from aerial2ground.exported_policy import COLOUR_ORDERS, ExportedPolicy, PolicyInfo, policy_from_bytes
from aerial2ground.imitation import METHODS, network_answer
from aerial2ground.learning_stages import load_network, sources_of
from aerial2ground.networks import PictureNetwork
from hashnerf.checkpoints import checkpoint_steps
from hashnerf.command_line import config_changes, plain_config
from hashnerf.errors import UserError
from hashnerf.made_from import MADE_FROM
from hashnerf.transforms_json import read_transforms, write_atomically

FILE = "policy.onnx"
OPSET, IR_VERSION = 17, 8
"""Of 2022: every onnxruntime from 1.12 on reads them, those of single-board computers too."""
PARITY = 1e-5
"""Largest difference from torch, radians."""


@dataclass(frozen=True)
class Export:
    """What was written."""

    path: Path
    size: int
    """Bytes."""
    parity: float
    """Largest difference from torch, radians."""


def export_policy(path: Path, network: PictureNetwork, limit: float, camera: CarCameraConfig) -> Export:
    """Writes a network that answers steering over `limit` (rad) and was trained for `camera` as a policy file.

    Raises UserError where the extra `export` is missing, where the camera's pictures have another size than the
    network's, or where the file steers otherwise than the network by more than `PARITY` on black, white and random
    pictures: then nothing is written.
    """
    height, width, channels = network.height, network.width, 4 if network.config.depth else 3
    if (camera.width, camera.height) != (width, height):
        raise UserError(
            f"{path}: the network reads {width} x {height} pixels, but camera.width and camera.height are "
            f"{camera.width} x {camera.height}; give the camera that it was trained for"
        )
    info = PolicyInfo(
        width,
        height,
        channels,
        limit,
        camera.field_of_view,
        camera.pitch,
        camera.depth_range if network.config.depth else 0.0,
        project_version(),
        colour_order=COLOUR_ORDERS[channels],
    )
    data = policy_bytes(network, info)
    error = parity_error(network, limit, policy_from_bytes(data, str(path)), extreme_pictures(info.shape))
    if not error <= PARITY:
        raise UserError(f"{path}: would steer {error:.2g} rad otherwise than the network, over {PARITY}; not written")
    write_atomically(path, data)
    return Export(path, len(data), error)


def export_trained(folder: Path, config: AerialConfig) -> Export:
    """Exports the network of `folder`, which is a checkpoint of `stages.save_network`, into that folder.

    Raises UserError where the config's camera is not the one of the pictures that the network has learnt from.
    """
    require_camera(folder, config)
    network = load_network(folder, config.imitation.task.network)
    return export_policy(folder / FILE, network, config.car.steering_limit, config.camera)


def require_camera(folder: Path, config: AerialConfig) -> None:
    """Raises UserError where a network in policies/<trajectory>/<method>/<seed> was trained for another camera."""
    trajectory, method = folder.parts[-3:-1] if len(folder.parts) > 3 else ("", "")
    if method not in METHODS:
        return
    for source in sources_of(config, method, trajectory):
        for file in (source / MADE_FROM, source.parent / MADE_FROM):
            camera = read_transforms(file).get("camera") if file.is_file() else None
            if camera is not None and config_changes(camera, plain_config(config.camera)):
                changes = "; ".join(config_changes(camera, plain_config(config.camera)))
                raise UserError(
                    f"{folder}: was trained for another camera ({changes}); give the config that it was trained with, "
                    "or render views and train anew"
                )


def trained_folders(folder: Path) -> list[Path]:
    """Returns every folder below `folder` that holds a trained network, in alphabetical order.

    Raises UserError where there is none.
    """
    found = sorted(one for one in folder.rglob("*") if one.is_dir() and checkpoint_steps(one))
    if not found:
        raise UserError(f"{folder}: no trained networks here; run scripts/train_policy.py first")
    return found


def policy_bytes(network: PictureNetwork, info: PolicyInfo) -> bytes:
    """Returns the contents of a policy file; batch normalisation is that of `eval`, whatever mode the network is in."""
    try:
        import onnx
        from onnx import TensorProto, helper, numpy_helper
    except ImportError as error:
        raise UserError("exporting needs the extra `export`: pip install -e .[export]") from error
    nodes: list = []
    weights: list = []

    def constant(name: str, value: np.ndarray) -> str:
        weights.append(numpy_helper.from_array(np.ascontiguousarray(value, np.float32), name))
        return name

    def then(operator: str, source: str, *others: str, **attributes: object) -> str:
        name = f"{operator.lower()}_{len(nodes)}"
        nodes.append(helper.make_node(operator, [source, *others], [name], **attributes))
        return name

    last = then("Cast", "picture", to=TensorProto.FLOAT)
    last = then("Transpose", last, perm=[0, 3, 1, 2])
    last = then("Div", last, constant("full_scale", np.array(255.0)))
    last = then("Sub", last, constant("middle", np.array(0.5)))
    layers = [*network.trunk, *network.head]
    for number, layer in enumerate(layers):
        if isinstance(layer, nn.AvgPool2d):
            size = int(layer.kernel_size)
            pads = [size // 2] * 4
            last = then("AveragePool", last, kernel_shape=[size, size], pads=pads, count_include_pad=0)
        elif isinstance(layer, nn.Conv2d):
            weight, bias = folded(layer, layers[number + 1])
            names = constant(f"weight_{number}", weight), constant(f"bias_{number}", bias)
            pads = [*layer.padding, *layer.padding]
            last = then("Conv", last, *names, strides=list(layer.stride), pads=pads)
        elif isinstance(layer, nn.Linear):
            parts = layer.weight.detach().cpu().numpy(), layer.bias.detach().cpu().numpy()
            names = constant(f"weight_{number}", parts[0]), constant(f"bias_{number}", parts[1])
            last = then("Gemm", last, *names, transB=1)
        elif not isinstance(layer, nn.BatchNorm2d):  # folded into the convolution before it
            last = then({nn.ReLU: "Relu", nn.Flatten: "Flatten"}[type(layer)], last)
    nodes.append(helper.make_node("Mul", [last, constant("limit", np.array(info.steering_limit))], ["steering"]))
    picture = helper.make_tensor_value_info("picture", TensorProto.UINT8, [1, *info.shape])
    steering = helper.make_tensor_value_info("steering", TensorProto.FLOAT, [1, 1])
    graph = helper.make_graph(nodes, "policy", [picture], [steering], weights)
    opset = helper.make_opsetid("", OPSET)
    model = helper.make_model(graph, opset_imports=[opset], ir_version=IR_VERSION, producer_name="aerial2ground")
    helper.set_model_props(model, info.as_metadata())
    onnx.checker.check_model(model, full_check=True)
    return model.SerializeToString(deterministic=True)


def folded(convolution: nn.Conv2d, normalisation: nn.Module) -> tuple[np.ndarray, np.ndarray]:
    """Returns weight and bias of a convolution followed by a batch normalisation in eval mode; sums are in float64."""
    assert isinstance(normalisation, nn.BatchNorm2d)
    norm = {name: tensor.detach().double().cpu() for name, tensor in normalisation.state_dict().items()}
    gain = norm["weight"] / (norm["running_var"] + normalisation.eps).sqrt()
    weight = convolution.weight.detach().double().cpu() * gain[:, None, None, None]
    own = convolution.bias.detach().double().cpu() if convolution.bias is not None else torch.zeros_like(gain)
    return weight.numpy(), (norm["bias"] + (own - norm["running_mean"]) * gain).numpy()


def parity_error(
    network: PictureNetwork, limit: float, policy: ExportedPolicy, pictures: UInt8[np.ndarray, "n h w c"]
) -> float:
    """Returns the largest difference (rad) between a policy and the network in eval mode; NaN if any answer is NaN."""
    training = network.training
    answer = network_answer(network.eval(), limit)
    try:
        return float(np.max([abs(policy(picture) - answer(picture)) for picture in pictures]))
    finally:
        network.train(training)


def extreme_pictures(shape: tuple[int, int, int]) -> UInt8[np.ndarray, "n h w c"]:
    """Returns what a network may meet at worst: black, white, a checkerboard, one half bright, and noise."""
    height, width, _ = shape
    rows, columns, _ = np.indices(shape)
    flat = [np.zeros(shape), np.full(shape, 255)]
    edges = [255 * ((rows + columns) % 2), 255 * (columns < width // 2), 255 * (rows < height // 2)]
    noise = np.random.default_rng(0).integers(0, 256, (8, *shape))
    return np.stack([*flat, *edges, *noise]).astype(np.uint8)


def project_version() -> str:
    """Version of the installed project; `unknown` where it only lies in a folder."""
    try:
        return version("carff-hashnerf")
    except PackageNotFoundError:
        return "unknown"
