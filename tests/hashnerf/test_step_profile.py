"""A profile of a real, tiny training names its parts, and its tables add up."""

import pytest

from hashnerf import static_scene
from hashnerf.fit import BACKWARD, DRAW, OCCUPANCY, STEP, UPDATE, FitConfig
from hashnerf.render import FIELD, MARCH
from hashnerf.static_scene import StaticConfig, train_static
from hashnerf.step_profile import TrainingProfile, kernels_table, parts_table, profile_training
from tests.hashnerf.posed_scene import posed_scene


def test_the_parts_of_a_training(tmp_path, monkeypatch):
    monkeypatch.setattr(static_scene, "load_posed_images", lambda folder, size: posed_scene())
    fit = FitConfig(rays=64, batch_samples=512)
    config = StaticConfig(runs=str(tmp_path), threads=1, test_every=3, steps=4, fit=fit)
    found = profile_training(lambda: train_static(config))
    assert found.steps == 4 and set(found.parts_ms) == {DRAW, OCCUPANCY, STEP, MARCH, FIELD, BACKWARD, UPDATE}
    inner = found.parts_ms[BACKWARD] + found.parts_ms[UPDATE]
    assert 0 < inner < found.parts_ms[STEP] < found.total_ms
    assert "_EncodeBackward" in found.kernels_ms and found.kernels_ms["_EncodeBackward"][1] == 4


def test_tables_by_hand():
    found = TrainingProfile(10, {DRAW: 10.0, OCCUPANCY: 30.0, STEP: 60.0, BACKWARD: 20.0}, {"mm": (50.0, 40)})
    assert found.total_ms == pytest.approx(100.0)
    assert parts_table(found).rows[0] == ("rays and colours", "1.00 ms", "10.0 %")
    assert parts_table(found).rows[3] == ("· backward", "2.00 ms", "20.0 %")
    assert kernels_table(found).rows == (("`mm`", "5.00 ms", "50.0 %", "4.0"),)


def test_a_training_that_was_finished_has_no_steps():
    assert profile_training(lambda: None).steps == 0
