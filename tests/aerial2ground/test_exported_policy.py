"""Policy files that are not what they should be, and pictures that do not fit them."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

from aerial2ground.car_camera import CarCameraConfig
from aerial2ground.exported_policy import PolicyInfo, load_exported, policy_from_bytes
from aerial2ground.networks import NetworkConfig, PictureNetwork
from aerial2ground.policy_export import export_policy, policy_bytes
from hashnerf.errors import UserError

ROOT = Path(__file__).resolve().parents[2]
INFO = PolicyInfo(32, 18, 3, 0.4189, 100.0, -6.0)
DEEP = PolicyInfo(32, 18, 4, 0.4189, 100.0, 0.5, 4.0, "0.1.0", colour_order="RGBD")


@pytest.fixture(scope="module")
def data() -> bytes:
    """A policy file's contents."""
    torch.manual_seed(0)
    return policy_bytes(PictureNetwork(NetworkConfig(), 18, 32, 1), INFO)


@pytest.fixture
def policy(data):
    """A loaded policy."""
    return policy_from_bytes(data, "policy.onnx")


def edited(data: bytes, change) -> bytes:
    """The file after `change` of its model."""
    model = onnx.load_model_from_string(data)
    change(model)
    return model.SerializeToString()


def test_it_is_read_without_torch_and_starts_without_onnxruntime():
    code = "import sys, aerial2ground.exported_policy; sys.exit('torch' in sys.modules or 'onnxruntime' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0


@pytest.mark.parametrize("info", [INFO, DEEP])
def test_metadata_there_and_back(info):
    assert PolicyInfo.from_metadata(info.as_metadata(), "x") == info


@pytest.mark.parametrize(
    "picture, given",
    [
        (np.zeros((36, 64, 3), np.uint8), r"not uint8 \(36, 64, 3\)"),
        (np.zeros((32, 18, 3), np.uint8), r"not uint8 \(32, 18, 3\)"),
        (np.zeros((18, 32, 4), np.uint8), r"not uint8 \(18, 32, 4\)"),
        (np.zeros((18, 32), np.uint8), r"not uint8 \(18, 32\)"),
        (np.zeros((1, 18, 32, 3), np.uint8), r"not uint8 \(1, 18, 32, 3\)"),
        (np.zeros((18, 32, 3), np.float32), r"not float32 \(18, 32, 3\)"),
    ],
)
def test_pictures_of_another_size_or_kind_are_refused(policy, picture, given):
    with pytest.raises(UserError, match=r"policy\.onnx: reads RGB pictures as uint8 \(18, 32, 3\).*" + given):
        policy(picture)


def test_pictures_that_do_not_lie_in_one_piece(policy):
    wide = np.random.default_rng(0).integers(0, 256, (18, 64, 3), dtype=np.uint8)
    assert policy(wide[:, ::2]) == policy(wide[:, ::2].copy())


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(UserError, match=r"no such file; export a policy with scripts/export_policy\.py"):
        load_exported(tmp_path / "policy.onnx")
    with pytest.raises(UserError, match="no such file"):
        load_exported(tmp_path)


@pytest.mark.parametrize("cut", [0, 1, 100, -1000, -200])
def test_truncated_files(tmp_path, data, cut):
    (tmp_path / "policy.onnx").write_bytes(data[:cut])
    with pytest.raises(UserError, match=r"policy\.onnx: "):
        load_exported(tmp_path / "policy.onnx")


@pytest.mark.parametrize("text", [b"hello", b"\x89PNG\r\n\x1a\n" + bytes(100), b"{}" * 1000])
def test_files_that_are_not_onnx(tmp_path, text):
    (tmp_path / "policy.onnx").write_bytes(text)
    with pytest.raises(UserError, match="is not a whole ONNX file"):
        load_exported(tmp_path / "policy.onnx")


def test_a_file_larger_than_any_policy(tmp_path):
    with open(tmp_path / "policy.onnx", "wb") as file:
        file.truncate(300 * 1024 * 1024)  # takes no room on the disk
    with pytest.raises(UserError, match="is over 256 MB"):
        load_exported(tmp_path / "policy.onnx")


def without(key):
    def change(model):
        kept = [one for one in model.metadata_props if one.key != key]
        del model.metadata_props[:]
        model.metadata_props.extend(kept)

    return change


def told(key, value):
    def change(model):
        next(one for one in model.metadata_props if one.key == key).value = value

    return change


@pytest.mark.parametrize(
    "change, sentence",
    [
        (without("steering_limit"), "lacks steering_limit; export the policy"),
        (
            lambda model: model.ClearField("metadata_props"),
            "lacks width, height, channels, steering_limit, field_of_view, pitch",
        ),
        (without("field_of_view"), "lacks field_of_view; export the policy with scripts/export_policy.py"),
        (without("pitch"), "lacks pitch; export the policy"),
        (told("field_of_view", "1.745"), "the field of view 1.745 is not 10 to 150 degrees"),
        (told("pitch", "nan"), "the pitch nan is not -80 to 80 degrees"),
        (told("width", "thirty"), "invalid literal"),
        (told("steering_limit", "nan"), "the steering limit nan is no angle"),
        (told("steering_limit", "24"), "the steering limit 24.0 is no angle"),
        (told("task", "localisation"), "the task is 'localisation'"),
        (told("units", "degrees"), "in 'degrees', not"),
        (told("colour_order", "BGR"), "in the order 'BGR' are not known"),
        (told("depth_range", "4.0"), "the depth range 4.0 does not fit 3 channels"),
        (told("width", "64"), "its graph reads and answers"),
    ],
)
def test_metadata_that_is_missing_or_wrong(data, change, sentence):
    with pytest.raises(UserError, match=r"policy\.onnx: .*" + sentence):
        policy_from_bytes(edited(data, change), "policy.onnx")


def test_an_onnx_file_of_something_else():
    port = [onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [1]) for name in ("x", "y")]
    graph = onnx.helper.make_graph([onnx.helper.make_node("Relu", ["x"], ["y"])], "g", port[:1], port[1:])
    opset = [onnx.helper.make_opsetid("", 17)]
    other = onnx.helper.make_model(graph, opset_imports=opset, ir_version=8).SerializeToString()
    with pytest.raises(UserError, match="lacks width"):
        policy_from_bytes(other, "other.onnx")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_file_that_answers_no_number_is_refused_at_once(data, value):
    def spoil(model):
        bias = next(one for one in model.graph.initializer if one.name == "limit")
        bias.CopyFrom(onnx.numpy_helper.from_array(np.float32(value).reshape(()), "limit"))

    with pytest.raises(UserError, match="the file is damaged"):
        policy_from_bytes(edited(data, spoil), "policy.onnx")


def test_without_onnxruntime_the_extra_is_named(monkeypatch, data):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(UserError, match=r"need the extra `export`: pip install -e \.\[export\]"):
        policy_from_bytes(data, "policy.onnx")


@pytest.mark.parametrize("changes", [{"channels": 5}, {"width": 0}, {"colour_order": "RGBD"}, {"depth_range": 1.0}])
def test_impossible_policies(changes):
    with pytest.raises(UserError):
        replace(INFO, **changes)


def test_a_moved_file_still_steers(tmp_path):
    network = PictureNetwork(NetworkConfig(depth=True), 18, 32, 1)
    export = export_policy(tmp_path / "a" / "policy.onnx", network, 0.4, CarCameraConfig(32, 18))
    moved = export.path.rename(tmp_path / "moved.onnx")
    assert load_exported(moved).info.shape == (18, 32, 4) and load_exported(moved).info.depth_range == 4.0
