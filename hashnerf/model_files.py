"""Trained models on disk: `<stage>/model/` holds the weights that inference uses, and what training them cost."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from torch import Tensor, nn

from hashnerf.checkpoints import load_checkpoint, load_module_state, module_tensors, save_checkpoint
from hashnerf.errors import UserError
from hashnerf.training_run import TrainingRun

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
    load_module_state(module, tensors, PREFIX)
    return module, cost
