"""Trained models on disk: `<stage>/model/` holds the weights that inference uses, and what training them cost."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from torch import Tensor, nn

from hashnerf.checkpoints import (
    TENSORS,
    checkpoint_steps,
    load_checkpoint,
    load_module_state,
    module_tensors,
    save_checkpoint,
)
from hashnerf.errors import DataError, UserError
from hashnerf.made_from import digest
from hashnerf.training_run import CONFIG, TrainingRun

Module = TypeVar("Module", bound=nn.Module)

MODEL = "model"
PREFIX = "model"


def save_model(folder: Path, module: nn.Module, run: TrainingRun) -> None:
    """Saves a module's weights with the seconds and the peak memory of its training."""
    cost = {"seconds": round(run.seconds, 2), "peak_memory_mb": round(run.peak_memory_mb, 1)}
    save_checkpoint(folder / MODEL, run.completed, module_tensors(module, PREFIX), cost, keep=1)


def load_model(folder: Path, build: Callable[[dict[str, Tensor]], Module], script: str) -> tuple[Module, dict]:
    """Builds a module from the names and shapes of its saved weights, loads them, and returns it with its cost.

    Raises UserError naming the script to run first when there is no model.
    """
    if not (folder / MODEL).is_dir():
        raise UserError(f"{folder}: no trained model here; run {script} first")
    _, tensors, cost = load_checkpoint(folder / MODEL)
    module = build({name.removeprefix(f"{PREFIX}."): tensor for name, tensor in tensors.items()})
    try:
        load_module_state(module, tensors, PREFIX)
    except DataError as error:
        raise UserError(
            f"{folder}: {error}; give the config that it was trained with ({folder / CONFIG}), or run {script} again"
        ) from error
    return module, cost


def has_model(folder: Path) -> bool:
    """Whether a model was saved here."""
    return bool(checkpoint_steps(folder / MODEL))


def weights_digest(folder: Path) -> str:
    """Returns 16 hexadecimal digits that change with the saved weights; raises UserError where there are none."""
    if not has_model(folder):
        raise UserError(f"{folder}: no trained model here")
    return digest(folder / MODEL / f"{checkpoint_steps(folder / MODEL)[-1]:07d}" / TENSORS)
