"""Saved models: same weights back, and a sentence where there is none or it does not fit."""

import pytest
import torch
from torch import nn

from hashnerf.errors import UserError
from hashnerf.model_files import load_model, save_model
from hashnerf.training_run import TrainingRun


def saved(folder) -> nn.Linear:
    torch.manual_seed(0)
    layer = nn.Linear(3, 2)
    with TrainingRun(folder, {}, 1, {"layer": layer}) as run:
        for _ in run.steps():
            layer.weight.data += 1
        save_model(folder, layer, run)
    return layer


def test_weights_and_shapes_come_back(tmp_path):
    layer = saved(tmp_path)
    loaded, cost = load_model(tmp_path, lambda tensors: nn.Linear(*tensors["weight"].shape[::-1]), "x.py")
    assert torch.equal(loaded.weight, layer.weight)
    assert set(cost) == {"seconds", "peak_memory_mb"}


def test_a_missing_model_names_the_script(tmp_path):
    with pytest.raises(UserError, match=r"run scripts/train_x.py first"):
        load_model(tmp_path, lambda _: nn.Linear(1, 1), "scripts/train_x.py")


def test_another_shape_is_named(tmp_path):
    saved(tmp_path)
    with pytest.raises(UserError, match=r"weight has shape \(2, 3\)"):
        load_model(tmp_path, lambda _: nn.Linear(4, 2), "x.py")
