"""Exported policies steer like the networks that they were made of; what does not is never written."""

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from torch import nn

from aerial2ground.car import CarConfig
from aerial2ground.car_camera import CarCameraConfig
from aerial2ground.driving import DriveConfig, drive
from aerial2ground.exported_policy import load_exported
from aerial2ground.imitation import network_policy
from aerial2ground.learning_stages import policy_folder, run_policies
from aerial2ground.networks import NetworkConfig, PictureNetwork
from aerial2ground.paths import Path as CarPath
from aerial2ground.policy_export import (
    IR_VERSION,
    OPSET,
    PARITY,
    export_policy,
    export_trained,
    extreme_pictures,
    folded,
    parity_error,
    policy_bytes,
    trained_folders,
)
from aerial2ground.policy_training import TaskConfig, train_network
from aerial2ground.pure_pursuit import PurePursuitConfig
from aerial2ground.stages import run_ground_views
from hashnerf.errors import UserError

ROOT = Path(__file__).resolve().parents[2]
LIMIT = 0.4189
PAPER = NetworkConfig()


def lively(config=PAPER, height=36, width=64, seed=0) -> PictureNetwork:
    """A network with random statistics in its normalisation, and answers over the whole range of steering."""
    torch.manual_seed(seed)
    network = PictureNetwork(config, height, width, 1)
    for layer in network.trunk:
        if isinstance(layer, nn.BatchNorm2d):
            nn.init.uniform_(layer.running_mean, -0.5, 0.5)
            nn.init.uniform_(layer.running_var, 0.1, 2.0)
            nn.init.uniform_(layer.weight, 0.5, 2.0)
            nn.init.uniform_(layer.bias, -0.5, 0.5)
    with torch.no_grad():
        network.head[-1].weight.mul_(10)
    return network.eval()


CAMERA = CarCameraConfig(width=64, height=36, field_of_view=90.0, pitch=-4.0, depth_range=3.0)


def exported(tmp_path, network):
    camera = replace(CAMERA, width=network.width, height=network.height)
    return load_exported(export_policy(tmp_path / "policy.onnx", network, LIMIT, camera).path)


@pytest.mark.parametrize("size", [(36, 64), (120, 160), (17, 31)])
@pytest.mark.parametrize("config", [PAPER, NetworkConfig(depth=True), NetworkConfig(4, 2, 16)])
def test_random_networks_on_extreme_pictures(tmp_path, size, config):
    network = lively(config, *size)
    policy = exported(tmp_path, network)
    pictures = extreme_pictures(policy.info.shape)
    assert pictures[0].max() == 0 and pictures[1].min() == 255 and len(pictures) > 8
    answers = [policy(picture) for picture in pictures]
    assert np.ptp(answers) > 1e-3, "a network that answers the same to everything proves nothing"
    assert parity_error(network, LIMIT, policy, pictures) <= 1e-5


def test_a_trained_network(tmp_path):
    pictures = torch.randint(0, 256, (64, 18, 32, 3), dtype=torch.uint8)
    targets = (pictures[:, :, :16].float().mean(dim=(1, 2, 3)) / 64 - 2)[:, None]
    network = train_network(TaskConfig(epochs=5, batch_size=16), pictures, targets, "l1", 0)
    policy = exported(tmp_path, network)
    assert parity_error(network, LIMIT, policy, pictures.numpy()) <= 1e-5


def test_a_changed_weight_fails(tmp_path):
    network = lively()
    policy = exported(tmp_path, network)
    pictures = extreme_pictures(policy.info.shape)
    weights = [*network.parameters(), *(buffer for name, buffer in network.named_buffers() if "running" in name)]
    assert len(weights) == 10 + 10 + 6 + 10
    for weight in weights:
        before = weight.detach().clone()
        with torch.no_grad():
            weight.add_(0.05)
        assert parity_error(network, LIMIT, policy, pictures) > PARITY
        with torch.no_grad():
            weight.copy_(before)
    assert parity_error(network, LIMIT, policy, pictures) <= PARITY
    assert parity_error(network, LIMIT * 1.01, policy, pictures) > PARITY


@pytest.mark.parametrize("broken", ["weight_0", "full_scale", "middle", "limit"])
def test_a_file_that_steers_otherwise_is_not_written(tmp_path, monkeypatch, broken):
    def wrong(network, info):
        model = onnx.load_model_from_string(policy_bytes(network, info))
        part = next(one for one in model.graph.initializer if one.name == broken)
        part.CopyFrom(onnx.numpy_helper.from_array(onnx.numpy_helper.to_array(part) * np.float32(1.02), broken))
        return model.SerializeToString()

    (tmp_path / "policy.onnx").write_bytes(b"old")
    monkeypatch.setattr("aerial2ground.policy_export.policy_bytes", wrong)
    with pytest.raises(UserError, match="rad otherwise than the network, over 1e-05; not written"):
        export_policy(tmp_path / "policy.onnx", lively(), LIMIT, CAMERA)
    assert [(one.name, one.read_bytes()) for one in tmp_path.iterdir()] == [("policy.onnx", b"old")]


def test_networks_with_broken_weights_are_not_exported(tmp_path):
    network = lively()
    with torch.no_grad():
        network.head[-1].bias.fill_(math.nan)
    with pytest.raises(UserError, match="answers nan"):
        export_policy(tmp_path / "policy.onnx", network, LIMIT, CAMERA)
    assert not list(tmp_path.iterdir())


def test_a_network_of_another_size_than_the_camera_is_not_exported(tmp_path):
    with pytest.raises(UserError, match=r"reads 96 x 54 pixels, but camera.width and camera.height are 64 x 36"):
        export_policy(tmp_path / "policy.onnx", lively(PAPER, 54, 96), LIMIT, CAMERA)
    assert not list(tmp_path.iterdir())


def test_folding_is_the_normalisation_of_eval():
    network = lively()
    convolution, normalisation = network.trunk[0], network.trunk[1]
    pictures = torch.rand(2, 3, 9, 9)
    weight, bias = (torch.from_numpy(part).float() for part in folded(convolution, normalisation))
    with torch.no_grad():
        wanted = normalisation(convolution(pictures))
    assert torch.allclose(nn.functional.conv2d(pictures, weight, bias, 2, 1), wanted, atol=1e-5)


def test_the_mode_of_the_network_does_not_matter_and_stays(tmp_path):
    network = lively()
    wanted = exported(tmp_path, network)
    policy = exported(tmp_path, network.train())
    assert network.training and network.trunk[1].training
    picture = extreme_pictures(policy.info.shape)[-1]
    assert policy(picture) == wanted(picture)


def test_the_file_is_self_contained_repeatable_and_says_what_it_is(tmp_path):
    one = export_policy(tmp_path / "one.onnx", lively(NetworkConfig(depth=True)), LIMIT, CAMERA)
    two = export_policy(tmp_path / "two.onnx", lively(NetworkConfig(depth=True)), LIMIT, CAMERA)
    assert one.path.read_bytes() == two.path.read_bytes() and one.size == one.path.stat().st_size
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.onnx", "two.onnx"]
    model = onnx.load(one.path)
    assert (model.ir_version, model.opset_import[0].version) == (IR_VERSION, OPSET) == (8, 17)
    assert all(part.data_type == onnx.TensorProto.FLOAT for part in model.graph.initializer)
    assert all(part.data_location == onnx.TensorProto.DEFAULT for part in model.graph.initializer)
    assert not any(node.op_type == "BatchNormalization" for node in model.graph.node)
    about = {prop.key: prop.value for prop in model.metadata_props}
    assert about.pop("version")
    assert about == {
        "task": "steering",
        "width": "64",
        "height": "36",
        "channels": "4",
        "colour_order": "RGBD",
        "units": "radians, positive to the left",
        "steering_limit": "0.4189",
        "depth_range": "3.0",
        "field_of_view": "90.0",
        "pitch": "-4.0",
    }


def test_the_order_of_colours_and_the_sides_matter(tmp_path):
    policy = exported(tmp_path, lively())
    picture = extreme_pictures(policy.info.shape)[-1]
    assert abs(policy(picture) - policy(picture[..., ::-1])) > 1e-4
    assert abs(policy(picture) - policy(picture[:, ::-1])) > 1e-4


def test_nothing_of_the_extra_is_imported_at_start_up():
    code = "import sys, aerial2ground.policy_export; sys.exit(any(m in sys.modules for m in ('onnx', 'onnxruntime')))"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0


def test_without_onnx_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(UserError, match=r"needs the extra `export`: pip install -e \.\[export\]"):
        export_policy(tmp_path / "policy.onnx", lively(), LIMIT, CAMERA)


def test_a_place_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot be written"):
        export_policy(tmp_path / "file" / "policy.onnx", lively(), LIMIT, CAMERA)


def test_exported_policies_steer_like_their_networks_in_a_drive(tmp_path):
    network = lively()
    policy = exported(tmp_path, network)
    angle = np.linspace(0, 2 * math.pi, 181)
    circle = CarPath(1.5 * np.stack([np.cos(angle), np.sin(angle)], axis=1))

    rng = np.random.default_rng(0)
    seen = rng.integers(0, 256, (1000, 36, 64, 3), dtype=np.uint8)
    apart = []

    def both(picture, state):
        wanted = network_policy(network, LIMIT)(picture, state)
        apart.append(abs(policy(picture) - wanted))
        return policy(picture)

    def look(state):
        return seen[len(apart) % len(seen)]

    arguments = (np.zeros((0, 2)), circle, DriveConfig(laps=1), CarConfig(), PurePursuitConfig(), rng)
    moments = len(drive(both, look, lambda corners: False, *arguments).track)
    assert len(apart) == moments > 50 and max(apart) <= 1e-5


def test_every_trained_network_of_a_run(tiny_run):
    with pytest.raises(UserError, match="no trained networks here; run scripts/train_policy"):
        trained_folders(tiny_run.folder / "policies")
    run_ground_views(tiny_run)
    run_policies(tiny_run)
    folders = trained_folders(tiny_run.folder / "policies")
    names = ("left_turns", "outer_loop", "right_turns")
    assert folders == [policy_folder(tiny_run, name, "ours", 0) for name in names]
    exports = [export_trained(folder, tiny_run) for folder in folders]
    assert all(one.path == folder / "policy.onnx" for one, folder in zip(exports, folders))
    assert all(one.parity <= PARITY for one in exports)
    info, camera = load_exported(exports[0].path).info, tiny_run.camera
    assert info.shape == (18, 32, 3)
    assert (info.field_of_view, info.pitch) == (camera.field_of_view, camera.pitch) == (100.0, -6.0)
    assert trained_folders(tiny_run.folder / "policies") == folders
