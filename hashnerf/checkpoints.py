"""Checkpoints that survive kill -9, a full disk and a flipped bit: written aside, synced, hashed, re-read, renamed.

A checkpoint is a folder named by its step, seven digits (`0001500`): `tensors.safetensors`, `state.json` and
`manifest.json` (sha256 and size of the other two). `last` is a symbolic link to the newest one, for people; the loader
goes by the numbers. Step = number of finished training steps. Nothing here reads or writes pickle.
"""

import hashlib
import json
import logging
import os
import re
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import safetensors
import safetensors.torch
import torch
from torch import Tensor, nn

from hashnerf.errors import DataError, UserError

TENSORS, STATE, MANIFEST = "tensors.safetensors", "state.json", "manifest.json"
STEP_NAME = re.compile(r"\d{7,}")
TEMPORARY, REPLACED = ".writing-", ".replaced-"
MOST_LINES = 8  # of problems in one message: a model of another kind has hundreds

log = logging.getLogger(__name__)


class _Damaged(Exception):
    """A checkpoint that must not be loaded; the message says what is wrong with it."""


class Checkpoint(NamedTuple):
    """One verified checkpoint in memory, on the CPU."""

    step: int
    tensors: dict[str, Tensor]
    state: dict[str, Any]


def save_checkpoint(folder: Path, step: int, tensors: dict[str, Tensor], state: dict[str, Any], keep: int = 2) -> Path:
    """Write folder/<step> so that a crash at any moment leaves a good checkpoint; UserError when it cannot be written.

    The `keep` newest checkpoints stay. Steps beyond `step` are an abandoned future (training went back): removed too.
    """
    if keep < 1:
        raise UserError(f"keep = {keep} would delete every checkpoint; give 1 or more.")
    contents = {TENSORS: _tensor_bytes(tensors), STATE: json.dumps(state, allow_nan=False).encode()}
    contents[MANIFEST] = _manifest_bytes(step, contents)
    target = folder / f"{step:07d}"
    temporary = folder / f"{TEMPORARY}{target.name}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        sweep_leftovers(folder)
        _write_folder(temporary, contents)
        _read_folder(temporary, step)
        _move_into_place(temporary, target)
        _point_last_at(target)
    except (OSError, _Damaged) as error:
        shutil.rmtree(temporary, ignore_errors=True)
        raise UserError(
            f"{target}: the checkpoint could not be written ({error}); free the disk or mend the folder."
        ) from error
    _remove_old(folder, step, keep)
    return target


def load_checkpoint(folder: Path, step: int | None = None) -> Checkpoint:
    """Read the newest good checkpoint (or exactly `step`), logging what is wrong with newer ones; UserError if none."""
    steps = [step] if step is not None else sorted(checkpoint_steps(folder), reverse=True)
    if not steps:
        raise UserError(
            f"{folder}: no checkpoint here; train first or give the folder that holds the numbered folders."
        )
    problems = []
    for candidate in steps:
        try:
            checkpoint = _read_folder(folder / f"{candidate:07d}", candidate)
        except _Damaged as error:
            problems.append(str(error))
            continue
        for problem in problems:
            log.warning("%s; falling back to step %d.", problem, candidate)
        return checkpoint
    raise UserError("; ".join(problems) + ": no good checkpoint is left; restore a copy or train again.")


def checkpoint_steps(folder: Path) -> list[int]:
    """Steps of the checkpoint folders present, good or not, in ascending order."""
    if not folder.is_dir():
        return []
    return sorted(int(path.name) for path in folder.iterdir() if STEP_NAME.fullmatch(path.name) and path.is_dir())


def sweep_leftovers(folder: Path) -> None:
    """Remove what an interrupted save left behind, and put back a checkpoint that was only half replaced."""
    for path in folder.glob(f"{REPLACED}*"):
        original = folder / path.name.removeprefix(REPLACED)
        if not original.exists():
            os.rename(path, original)
    for path in [*folder.glob(f"{REPLACED}*"), *folder.glob(f"{TEMPORARY}*")]:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def pack(value: Any, name: str, tensors: dict[str, Tensor]) -> Any:
    """Turn a state tree into JSON, exactly: tensors move to `tensors` under names that start with `name`."""
    if isinstance(value, Tensor):
        tensors[name] = value
        return {"__tensor__": name}
    if isinstance(value, dict):
        items = [[key, pack(item, f"{name}.{key}", tensors)] for key, item in value.items()]
        if all(isinstance(key, str) and not key.startswith("__") for key in value):
            return dict(items)
        return {"__items__": items}  # JSON keys are text; an optimiser's are numbers
    if isinstance(value, list | tuple):
        parts = [pack(item, f"{name}.{index}", tensors) for index, item in enumerate(value)]
        return parts if isinstance(value, list) else {"__tuple__": parts}
    if isinstance(value, float) and not abs(value) < float("inf"):
        return {"__float__": repr(value)}  # JSON has no inf and no NaN
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"{name} is a {type(value).__name__}, which a checkpoint cannot hold")


def unpack(value: Any, tensors: dict[str, Tensor]) -> Any:
    """Undo `pack`."""
    if isinstance(value, list):
        return [unpack(item, tensors) for item in value]
    if not isinstance(value, dict):
        return value
    if "__tensor__" in value:
        return tensors[value["__tensor__"]]
    if "__items__" in value:
        return {key: unpack(item, tensors) for key, item in value["__items__"]}
    if "__tuple__" in value:
        return tuple(unpack(item, tensors) for item in value["__tuple__"])
    if "__float__" in value:
        return float(value["__float__"])
    return {key: unpack(item, tensors) for key, item in value.items()}


def module_tensors(module: nn.Module, prefix: str) -> dict[str, Tensor]:
    """Parameters and buffers of a module as `prefix.name` -> tensor."""
    return {f"{prefix}.{name}": tensor for name, tensor in module.state_dict().items()}


def load_module_state(module: nn.Module, tensors: dict[str, Tensor], prefix: str) -> None:
    """Copy `prefix.*` tensors into a module; DataError lists missing, unexpected, misshapen and non-finite ones."""
    given = {
        name.removeprefix(f"{prefix}."): tensor for name, tensor in tensors.items() if name.startswith(f"{prefix}.")
    }
    wanted = module.state_dict()
    parameters = {name for name, _ in module.named_parameters()}
    problems = [f"{prefix}.{name} is missing" for name in wanted.keys() - given.keys()]
    problems += [f"{prefix}.{name} is not part of this model" for name in given.keys() - wanted.keys()]
    for name in wanted.keys() & given.keys():
        tensor, shape = given[name], tuple(wanted[name].shape)
        if tuple(tensor.shape) != shape:
            problems.append(f"{prefix}.{name} has shape {tuple(tensor.shape)}, this model needs {shape}")
        elif tensor.is_floating_point() and _unusable(tensor, name in parameters):
            problems.append(f"{prefix}.{name} holds NaN or infinite values")
    if problems:
        lines = sorted(problems)
        if len(lines) > MOST_LINES:
            more = len(lines) - MOST_LINES + 1
            lines = [*lines[: MOST_LINES - 1], f"{more} more: was it written for another architecture? Train again."]
        raise DataError(f"checkpoint of '{prefix}' does not fit", lines)
    module.load_state_dict(given)


def _unusable(tensor: Tensor, is_parameter: bool) -> bool:
    """NaN anywhere, or an infinite weight; a buffer may hold infinity on purpose (a running maximum starts at -inf)."""
    return not bool(torch.isfinite(tensor).all()) if is_parameter else bool(torch.isnan(tensor).any())


def _tensor_bytes(tensors: dict[str, Tensor]) -> bytes:
    # Clones, because tensors that share storage (tied weights, views) may not be stored twice by reference.
    return safetensors.torch.save(
        {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}
    )


def _manifest_bytes(step: int, contents: dict[str, bytes]) -> bytes:
    files = {name: {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)} for name, data in contents.items()}
    return json.dumps({"step": step, "files": files}, indent=1).encode()


def _write_folder(folder: Path, contents: dict[str, bytes]) -> None:
    folder.mkdir()
    for name, data in contents.items():
        with open(folder / name, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    _sync_folder(folder)


def _read_folder(folder: Path, step: int) -> Checkpoint:
    """Read and verify one checkpoint folder; _Damaged says what is missing, cut short or altered."""
    contents = {}
    for name in (MANIFEST, TENSORS, STATE):
        path = folder / name
        if not path.is_file():
            raise _Damaged(f"{path} is missing")
        try:
            contents[name] = path.read_bytes()
        except OSError as error:
            raise _Damaged(f"{path} cannot be read ({error.strerror})") from error
    manifest = contents.pop(MANIFEST)
    if manifest != _manifest_bytes(step, contents):
        raise _Damaged(_difference(folder, step, manifest, contents))
    try:
        return Checkpoint(step, safetensors.torch.load(contents[TENSORS]), json.loads(contents[STATE]))
    except (safetensors.SafetensorError, ValueError, RecursionError) as error:
        raise _Damaged(f"{folder} does not parse ({error})") from error


def _difference(folder: Path, step: int, manifest: bytes, contents: dict[str, bytes]) -> str:
    """Which file disagrees with the manifest, in words."""
    try:
        recorded = json.loads(manifest)["files"]
        for name, data in contents.items():
            if recorded[name]["bytes"] != len(data):
                return f"{folder / name} is {len(data)} bytes long instead of {recorded[name]['bytes']}"
            if recorded[name]["sha256"] != hashlib.sha256(data).hexdigest():
                return f"{folder / name} has been altered (its sha256 differs from the manifest)"
    except (ValueError, KeyError, TypeError, RecursionError):
        pass
    return f"{folder / MANIFEST} has been altered or does not belong to step {step}"


def _move_into_place(temporary: Path, target: Path) -> None:
    """Rename the finished folder; an existing checkpoint of the same step stays reachable until the new one stands."""
    replaced = target.with_name(f"{REPLACED}{target.name}")
    if target.exists():
        os.rename(target, replaced)
    os.rename(temporary, target)
    _sync_folder(target.parent)
    shutil.rmtree(replaced, ignore_errors=True)


def _point_last_at(target: Path) -> None:
    """Swap the `last` link in one rename; a file system without links costs a warning, not the training."""
    link = target.with_name(f"{TEMPORARY}last")
    try:
        link.unlink(missing_ok=True)
        os.symlink(target.name, link)  # relative, so that a moved run folder still works
        os.replace(link, target.with_name("last"))
        _sync_folder(target.parent)
    except OSError as error:
        log.warning("%s could not be updated (%s).", target.with_name("last"), error.strerror)


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _remove_old(folder: Path, newest: int, keep: int) -> None:
    """Delete all but the `keep` newest; the one just verified always stays; a failed deletion never ends training."""
    older = [step for step in checkpoint_steps(folder) if step < newest]
    beyond = [step for step in checkpoint_steps(folder) if step > newest]
    for step in beyond + older[: max(0, len(older) - (keep - 1))]:
        path = folder / f"{step:07d}"
        doomed = (
            folder / f"{TEMPORARY}{path.name}"
        )  # renamed first: a half-deleted checkpoint never bears a step's name
        try:
            os.rename(path, doomed)
            shutil.rmtree(doomed)
        except OSError as error:
            log.warning("%s could not be deleted (%s); delete it by hand.", path, error.strerror)
