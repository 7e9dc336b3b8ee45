"""Checkpoints: exact round trips, damage of every kind detected, and never a moment without a good one."""

import contextlib
import io
import json
import logging
import os
import random
import resource
import shutil
import time
from pathlib import Path

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hashnerf import checkpoints
from hashnerf.checkpoints import (
    checkpoint_steps,
    load_checkpoint,
    load_module_state,
    module_tensors,
    pack,
    save_checkpoint,
    sweep_leftovers,
    unpack,
)
from hashnerf.errors import DataError, UserError


def fill(value: float, size: int = 64) -> dict[str, torch.Tensor]:
    return {"a": torch.full((size,), value), "b": torch.arange(6).reshape(2, 3)}


def save_steps(folder: Path, *steps: int, keep: int = 2) -> None:
    for step in steps:
        save_checkpoint(folder, step, fill(float(step)), {"step": step}, keep)


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.parametrize(
    "tensor",
    [
        torch.randn(3, 4),
        torch.randn(3, 4, dtype=torch.float64),
        torch.randn(3, 4).to(torch.bfloat16),
        torch.randn(3, 4).half(),
        torch.tensor([True, False]),
        torch.tensor(7),
        torch.zeros(0, 3),
        torch.arange(5, dtype=torch.uint8),
        torch.arange(12).reshape(3, 4).T,
        torch.randn(6, requires_grad=True),
    ],
)
def test_tensors_come_back_bit_for_bit(tmp_path, tensor):
    save_checkpoint(tmp_path, 5, {"x": tensor}, {})
    loaded = load_checkpoint(tmp_path).tensors["x"]
    assert loaded.dtype == tensor.dtype
    assert loaded.shape == tensor.shape
    assert torch.equal(loaded, tensor)


def test_tensors_that_share_memory(tmp_path):
    base = torch.arange(6.0)
    save_checkpoint(tmp_path, 1, {"x": base, "tied": base, "part": base[2:4]}, {})
    step, tensors, state = load_checkpoint(tmp_path)
    assert (step, state) == (1, {})
    assert tensors["part"].tolist() == [2, 3]
    assert torch.equal(tensors["tied"], base)


TREES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.lists(inner, max_size=3).map(tuple)
        | st.dictionaries(st.text(max_size=3), inner, max_size=3)
        | st.dictionaries(st.integers(), inner, max_size=3)
        | st.dictionaries(st.sampled_from(["__tensor__", "__tuple__"]), inner)
    ),
    max_leaves=10,
)


@given(TREES)
def test_any_state_tree_survives_json(tree):
    tensors: dict[str, torch.Tensor] = {}
    back = unpack(json.loads(json.dumps(pack(tree, "t", tensors), allow_nan=False)), tensors)
    assert repr(back) == repr(tree)  # repr, because NaN differs from itself and 1 equals True


def test_an_object_that_cannot_be_saved_is_named():
    with pytest.raises(TypeError, match=r"t\.a\.1 is a set"):
        pack({"a": [1, {2}]}, "t", {})


def test_optimiser_state_is_exact(tmp_path):
    def training():
        torch.manual_seed(1)
        model = torch.nn.Linear(3, 2)
        groups = [{"params": [model.weight], "lr": 0.1}, {"params": [model.bias], "weight_decay": 0.01}]
        return model, torch.optim.AdamW(groups, lr=0.02, betas=(0.8, 0.95))

    def advance(model, optimizer, count):
        for _ in range(count):
            optimizer.zero_grad()
            (model(torch.ones(4, 3)) - 1).square().sum().backward()
            optimizer.step()

    model, optimizer = training()
    advance(model, optimizer, 5)
    tensors = module_tensors(model, "model")
    save_checkpoint(tmp_path, 5, tensors, {"optimizer": pack(optimizer.state_dict(), "optimizer", tensors)})
    advance(model, optimizer, 5)

    again, resumed = training()
    _, tensors, state = load_checkpoint(tmp_path)
    load_module_state(again, tensors, "model")
    resumed.load_state_dict(unpack(state["optimizer"], tensors))
    assert resumed.param_groups[1]["betas"] == (0.8, 0.95)
    assert resumed.state[again.weight]["step"] == 5
    advance(again, resumed, 5)
    for key, value in again.state_dict().items():
        assert torch.equal(value, model.state_dict()[key]), key


@pytest.mark.parametrize(("keep", "left"), [(1, [40]), (2, [30, 40]), (3, [20, 30, 40]), (9, [10, 20, 30, 40])])
def test_k10_the_newest_checkpoints_stay(tmp_path, keep, left, numeric_row):
    save_steps(tmp_path, 10, 20, 30, 40, keep=keep)
    numeric_row(
        "K10", f"keep {keep} of 4: steps wrongly kept or lost", len(set(checkpoint_steps(tmp_path)) ^ set(left))
    )
    assert os.readlink(tmp_path / "last") == "0000040"
    assert names(tmp_path) == {*(f"{step:07d}" for step in left), "last"}


def test_k10_keeping_none_is_refused_before_anything_is_touched(tmp_path, numeric_row):
    save_steps(tmp_path, 1)
    with pytest.raises(UserError, match="keep = 0"):
        save_checkpoint(tmp_path, 2, fill(2), {}, keep=0)
    numeric_row("K10", "keep 0: checkpoints lost", len({1} - set(checkpoint_steps(tmp_path))))


def test_going_back_removes_the_abandoned_future(tmp_path):
    save_steps(tmp_path, 10, 20, 30, keep=3)
    save_steps(tmp_path, 15, keep=3)
    assert checkpoint_steps(tmp_path) == [10, 15]
    assert load_checkpoint(tmp_path).step == 15


def test_the_same_step_again_replaces(tmp_path):
    save_steps(tmp_path, 10)
    save_checkpoint(tmp_path, 10, fill(99.0), {"again": True})
    step, tensors, state = load_checkpoint(tmp_path)
    assert (step, state, tensors["a"][0].item()) == (10, {"again": True}, 99.0)
    assert names(tmp_path) == {"0000010", "last"}


def test_a_moved_folder_still_loads(tmp_path):
    save_steps(tmp_path / "run", 10)
    shutil.move(tmp_path / "run", tmp_path / "elsewhere")
    assert load_checkpoint(tmp_path / "elsewhere").step == 10
    assert (tmp_path / "elsewhere" / "last" / "state.json").is_file()


def test_nothing_to_load(tmp_path):
    for folder in (tmp_path, tmp_path / "missing"):
        with pytest.raises(UserError, match="no checkpoint here"):
            load_checkpoint(folder)
    with pytest.raises(UserError, match=r"0000007.*missing"):
        load_checkpoint(tmp_path, step=7)


FILES = ("tensors.safetensors", "state.json", "manifest.json")


CUTS = {
    "0": lambda data: b"",
    "1": lambda data: data[:1],
    "10%": lambda data: data[: len(data) // 10],
    "50%": lambda data: data[: len(data) // 2],
    "-100": lambda data: data[:-100],
    "-1": lambda data: data[:-1],
    "longer": lambda data: data + b" ",
    "gone": None,
    "folder": None,
}


@pytest.mark.parametrize("name", FILES)
def test_k04_a_cut_file_falls_back_and_says_which(tmp_path, caplog, name, numeric_row):
    wrong = []
    for cut, change in CUTS.items():
        folder = tmp_path / cut
        save_steps(folder, 10, 20)
        path = folder / "0000020" / name
        data = path.read_bytes()
        path.unlink()
        if cut == "folder":
            path.mkdir()
        if change is not None:
            path.write_bytes(change(data))
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            step = load_checkpoint(folder).step
        said = name in caplog.text and "falling back to step 10" in caplog.text
        wrong += [] if step == 10 and said and len(caplog.messages) == 1 else [cut]
        with pytest.raises(UserError, match=name):
            load_checkpoint(folder, step=20)
    print(wrong)
    numeric_row("K04", f"{name} cut to {', '.join(CUTS)}: not fallen back in words", len(wrong))


def test_k05_every_flipped_bit_is_found(tmp_path, numeric_row):
    save_steps(tmp_path, 10)
    draw, silent = random.Random(0), 0
    for number in range(150):
        path = tmp_path / "0000010" / FILES[number % 3]
        good = path.read_bytes()
        bad = bytearray(good)
        place = draw.randrange(len(bad))
        bad[place] ^= 1 << draw.randrange(8)
        path.write_bytes(bad)
        try:
            load_checkpoint(tmp_path)
        except UserError as error:
            assert "no good checkpoint is left" in str(error)
        else:
            silent += 1
        path.write_bytes(good)
    assert load_checkpoint(tmp_path).step == 10
    numeric_row("K05", "150 bits of the three files, one at a time: flips that load", silent)


def test_a_checkpoint_under_another_steps_name_is_refused(tmp_path):
    save_steps(tmp_path, 10)
    os.rename(tmp_path / "0000010", tmp_path / "0000030")
    with pytest.raises(UserError, match="step 30"):
        load_checkpoint(tmp_path)


def evil_headers() -> dict[str, bytes]:
    """Safetensors files that lie in their header."""

    def file(header: str, data: bytes = b"") -> bytes:
        return len(header).to_bytes(8, "little") + header.encode() + data

    def entry(shape: str, start: int, end: int) -> str:
        return f'{{"dtype":"F32","shape":{shape},"data_offsets":[{start},{end}]}}'

    return {
        "length 2**63": (2**63).to_bytes(8, "little") + b"{}",
        "length beyond the file": (10_000).to_bytes(8, "little") + b"{}",
        "101 MB of JSON": file("{" + " " * 101_000_000 + "}"),
        "a name twice": file(f'{{"a":{entry("[1]", 0, 4)},"a":{entry("[1]", 4, 8)}}}', bytes(8)),
        "overlap": file(f'{{"a":{entry("[2]", 0, 8)},"b":{entry("[2]", 4, 12)}}}', bytes(12)),
        "hole": file(f'{{"a":{entry("[1]", 0, 4)},"b":{entry("[1]", 8, 12)}}}', bytes(12)),
        "shape": file(f'{{"a":{entry("[3]", 0, 8)}}}', bytes(8)),
        "huge shape": file(f'{{"a":{entry("[4294967296,4294967296,4294967296]", 0, 8)}}}', bytes(8)),
        "deep": file('{"a":' * 100_000),
        "no header": b"",
    }


def plant(folder: Path, tensor_file: bytes) -> None:
    """A checkpoint whose manifest vouches for whatever its tensor file is."""
    save_steps(folder, 10)
    contents = {"tensors.safetensors": tensor_file, "state.json": b"{}"}
    for name, data in contents.items():
        (folder / "0000010" / name).write_bytes(data)
    (folder / "0000010" / "manifest.json").write_bytes(checkpoints._manifest_bytes(10, contents))


def test_k32_a_lying_tensor_file_with_a_matching_manifest_is_refused(tmp_path, numeric_row):
    seconds, megabytes, loaded = [], [], 0
    for kind, data in evil_headers().items():
        plant(tmp_path / kind, data)
        start = time.process_time()
        try:
            load_checkpoint(tmp_path / kind)
            loaded += 1
        except UserError as error:
            assert "does not parse" in str(error)
        seconds.append(time.process_time() - start)
        megabytes.append(peak_growth(tmp_path / kind))
    numeric_row("K32", f"{len(seconds)} headers that lie: files that load", loaded)
    numeric_row("K32", "processor seconds of the slowest refusal", max(seconds), 1.0)
    numeric_row("K32", "MB that the refusal with the most memory takes", max(megabytes), 200.0)


def peak_growth(folder: Path) -> float:
    """Megabytes by which the peak memory of a process of its own grows when it loads; our own peak lies behind us."""
    reader, writer = os.pipe()
    if os.fork() == 0:
        try:
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            with contextlib.suppress(UserError):
                load_checkpoint(folder)
            os.write(writer, str(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before).encode())
        finally:
            os._exit(0)
    os.wait()
    os.close(writer)
    with open(reader) as told:
        return float(told.read()) / 1000


class Touch:
    """What a pickle may do when it is read: run any function, here one that makes a file."""

    def __init__(self, path: Path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_k30_k31_a_pickle_in_the_place_of_tensors_is_not_run(tmp_path, numeric_row):
    proof = tmp_path / "proof"
    buffer = io.BytesIO()
    torch.save({"a": Touch(proof)}, buffer)
    plant(tmp_path / "run", buffer.getvalue())
    with pytest.raises(UserError, match="does not parse"):
        load_checkpoint(tmp_path / "run")
    for row in ("K30", "K31"):
        numeric_row(row, "a pickle with a matching manifest: files that it made", proof.exists())


def test_k12_strict_module_loading_names_every_problem(numeric_row):
    model = torch.nn.Sequential(torch.nn.Linear(2, 3), torch.nn.BatchNorm1d(3), torch.nn.Linear(3, 1))
    tensors = module_tensors(model, "m")
    before = {name: value.clone() for name, value in model.state_dict().items()}
    tensors["m.0.weight"] = torch.full((3, 2), torch.nan)
    tensors["m.0.bias"] = torch.tensor([0.0, torch.inf, 0.0])
    tensors["m.1.running_mean"] = torch.full((3,), torch.nan)
    tensors["m.2.weight"] = torch.zeros(1, 4)
    tensors["m.9.weight"] = torch.zeros(1)
    del tensors["m.2.bias"]
    tensors["other.weight"] = torch.zeros(1)  # another object's, not ours to judge
    with pytest.raises(DataError) as caught:
        load_module_state(model, tensors, "m")
    expected = [
        "m.0.bias holds NaN or infinite values",
        "m.0.weight holds NaN or infinite values",
        "m.1.running_mean holds NaN or infinite values",
        "m.2.bias is missing",
        "m.2.weight has shape (1, 4), this model needs (1, 3)",
        "m.9.weight is not part of this model",
    ]
    unnamed = len(set(expected) ^ set(caught.value.problems))
    numeric_row("K12", "missing, extra, wrong shape, NaN, inf: problems not named", unnamed)
    changed = sum(not torch.equal(value, before[name]) for name, value in model.state_dict().items())
    numeric_row("K12", "the same: weights that were changed all the same", changed)


def test_a_checkpoint_of_another_model_is_told_briefly():
    model = torch.nn.Sequential(*(torch.nn.Linear(1, 1) for _ in range(10)))
    with pytest.raises(DataError) as caught:
        load_module_state(model, {}, "m")
    assert len(caught.value.problems) == 8
    assert caught.value.problems[0] == "m.0.bias is missing"
    assert caught.value.problems[-1].startswith("13 more: ")


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64])
def test_k11_weights_of_another_precision_load_into_a_float_model(tmp_path, dtype, numeric_row):
    """What a file holds has a precision of its own; what a model computes in is the model's. No file names a device."""
    values = torch.tensor([[0.1, 3.0]]).to(dtype)
    save_checkpoint(tmp_path, 1, {"m.weight": values, "m.bias": torch.ones(1, dtype=dtype)}, {})
    tensors, model = load_checkpoint(tmp_path).tensors, torch.nn.Linear(2, 1)
    load_module_state(model, tensors, "m")
    assert {tensor.device.type for tensor in tensors.values()} == {"cpu"} and model.weight.dtype == torch.float32
    error = float((model.weight.detach() - values.float()).abs().max()) + float(tensors["m.weight"].dtype != dtype)
    numeric_row("K11", f"a {dtype} file into a float32 model on the CPU", error)


def test_a_buffer_may_be_infinite():
    model = torch.nn.Module()
    model.register_buffer("largest", torch.tensor(0.0))
    load_module_state(model, {"m.largest": torch.tensor(-torch.inf)}, "m")
    assert model.largest == -torch.inf


def test_leftovers_are_swept_and_a_half_replaced_checkpoint_returns(tmp_path):
    save_steps(tmp_path, 10, 20)
    (tmp_path / ".writing-0000030").mkdir()
    (tmp_path / ".writing-last").symlink_to("0000030")
    os.rename(tmp_path / "0000020", tmp_path / ".replaced-0000020")  # killed between the two renames
    shutil.copytree(tmp_path / "0000010", tmp_path / ".replaced-0000010")  # killed before the old one was deleted
    sweep_leftovers(tmp_path)
    assert names(tmp_path) == {"0000010", "0000020", "last"}
    assert load_checkpoint(tmp_path).step == 20
    sweep_leftovers(tmp_path / "missing")
