"""A training that is given seconds: the preset that fits, and a run that was begun keeps its steps."""

import pytest

from hashnerf import static_budget, static_scene
from hashnerf.errors import UserError
from hashnerf.fit import FitConfig
from hashnerf.static_budget import seconds_per_step, within_seconds
from hashnerf.static_scene import StaticConfig, train_static
from tests.hashnerf.posed_scene import posed_scene

PRESETS = {"fast": 3, "balanced": 30, "accurate": 300}


@pytest.fixture
def config(tmp_path, monkeypatch):
    monkeypatch.setattr(static_scene, "load_posed_images", lambda folder, size: posed_scene())
    return StaticConfig(runs=str(tmp_path), threads=1, test_every=0, fit=FitConfig(rays=64, batch_samples=512))


def test_the_preset_that_fits_the_pace(config, monkeypatch):
    monkeypatch.setattr(static_budget, "seconds_per_step", lambda own, train: 0.1)
    chosen, reason = within_seconds(config, PRESETS, 10.0)
    # 0.1 s a step, 1.4 times that later: 0.42, 4.2 and 42 s
    assert chosen.steps == 30 and "takes balanced" in reason and "accurate 42 s" in reason
    with pytest.raises(UserError, match=r"max_seconds is 0\.1: no preset fits"):
        within_seconds(config, PRESETS, 0.1)


def test_a_run_that_was_begun_keeps_its_steps(config, monkeypatch):
    monkeypatch.setattr(static_budget, "seconds_per_step", lambda own, train: 0.1)
    chosen, _ = within_seconds(config, PRESETS, 1.0)
    train_static(chosen)
    monkeypatch.setattr(static_budget, "seconds_per_step", lambda own, train: 1e-6)
    again, reason = within_seconds(config, PRESETS, 1.0)
    assert again.steps == 3 and "was begun with 3 steps" in reason
    train_static(again)


def test_a_run_that_died_before_it_saved_anything_is_no_run(config, monkeypatch):
    monkeypatch.setattr(static_budget, "seconds_per_step", lambda own, train: 0.1)
    folder = config.folder / "field"
    folder.mkdir(parents=True)
    (folder / "config.yaml").write_text("steps: 5000\n")
    assert within_seconds(config, PRESETS, 10.0)[0].steps == 30


def test_the_pace_is_measured_on_a_field_that_is_thrown_away(config, monkeypatch):
    monkeypatch.setattr(static_budget, "TRIAL_STEPS", 3)
    clock = iter([100.0, 200.0, 206.0])  # the first reading is before the warm-up
    monkeypatch.setattr(static_budget, "perf_counter", lambda: next(clock))
    assert seconds_per_step(config, posed_scene().split("train")) == pytest.approx(2.0)
    assert not config.folder.exists()
