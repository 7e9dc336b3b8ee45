"""A static scene from pictures alone: it learns, holds pictures out, continues and says what it chose."""

import json
from dataclasses import replace

import pytest
import torch
from PIL import Image

from hashnerf import static_scene
from hashnerf.command_line import load_config
from hashnerf.errors import UserError
from hashnerf.fit import FitConfig
from hashnerf.static_scene import StaticConfig, load_scene, one_colour_psnr, train_static
from tests.hashnerf.posed_scene import posed_scene


@pytest.fixture
def config(tmp_path, monkeypatch):
    data = posed_scene(count=24, size=24)
    monkeypatch.setattr(static_scene, "load_posed_images", lambda folder, size: data)
    fit = FitConfig(learning_rate=0.1, batch_samples=12288)
    return StaticConfig(runs=str(tmp_path), steps=100, threads=1, test_every=0, fit=fit)


def test_it_learns_what_it_has_not_seen_and_says_what_it_chose(config, capsys, monkeypatch):
    found = train_static(config)
    assert found["psnr_db"] > found["psnr_one_colour_db"] + 2
    assert (found["training_pictures"], found["test_pictures"]) == (18, 6)
    assert f"{found['field']['levels']} levels" in capsys.readouterr().err
    assert json.loads((config.folder / "reconstruction.json").read_text()) == found
    assert Image.open(config.folder / "held_out.png").size == (3 * 24, 2 * 24)
    stored = load_config(StaticConfig, config.folder / "config.yaml")
    assert stored.field.levels == found["field"]["levels"] > 0 and stored.march.candidates > 0
    # a finished run is measured again, not trained again
    assert train_static(config)["psnr_db"] == found["psnr_db"]
    # pictures that were learned from are no held-out ones
    more = posed_scene(count=24, size=24, test_every=3)
    monkeypatch.setattr(static_scene, "load_posed_images", lambda folder, size: more)
    with pytest.raises(UserError, match="test_every: 0 -> 3"):
        train_static(replace(config, test_every=3))


def test_the_pictures_of_one_state_are_chosen(config, monkeypatch):
    data = posed_scene()
    frames = tuple(replace(frame, branch=row % 2) for row, frame in enumerate(data.frames))
    monkeypatch.setattr(static_scene, "load_posed_images", lambda folder, size: replace(data, frames=frames))
    assert [frame.camera for frame in load_scene(replace(config, branch=1)).frames] == [1, 3, 5, 7]
    with pytest.raises(UserError, match="no training picture of branch 7, step 0"):
        load_scene(replace(config, branch=7))


def test_pictures_of_one_colour_have_no_psnr_that_json_knows(config, monkeypatch):
    data = posed_scene(count=24, size=24)
    monkeypatch.setattr(static_scene, "load_posed_images", lambda *_: replace(data, images=data.images * 0))
    found = train_static(replace(config, steps=2))
    assert found["psnr_one_colour_db"] is None
    assert json.loads((config.folder / "reconstruction.json").read_text()) == found


@pytest.mark.parametrize("box", [[0] * 6, [1, 1, 1, 0, 0, 0], [-2, -2, 2, 2, 2, 0], [-1e300, -2, 0, 1e300, 2, 2]])
def test_a_box_without_volume_or_without_end_is_refused_by_key(config, box):
    with pytest.raises(UserError, match=r"scene_box is .*each of the first three below"):
        load_scene(replace(config, scene_box=tuple(map(float, box))))


def test_a_box_that_nobody_stated_is_trimmed_to_what_is_seen(config, monkeypatch):
    data = posed_scene()
    loose = replace(data, scene_box=data.scene_box * 20, box_told=False)
    monkeypatch.setattr(static_scene, "load_posed_images", lambda folder, size: loose)
    trimmed = load_scene(config).scene_box
    assert (trimmed[0] > loose.scene_box[0]).any() and (trimmed >= loose.scene_box[0]).all()
    told = (-1.0, -1.0, -1.0, 1.0, 1.0, 1.0)
    assert load_scene(replace(config, scene_box=told)).scene_box.flatten().tolist() == list(told)


def test_one_colour_by_hand():
    data = posed_scene(count=4, size=4)
    dark = replace(data, images=torch.zeros_like(data.images))
    grey = replace(data, images=torch.full_like(data.images, 51))
    # black against 51 / 255 = 0.2: a squared error of 0.04, 10 log10(1 / 0.04) dB
    assert one_colour_psnr(grey, dark) == pytest.approx(13.979, abs=1e-3)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [({"steps": 0}, "steps is 0"), ({"test_every": 1}, "test_every is 1"), ({"scene_box": (0.0, 1.0)}, "scene_box is")],
)
def test_settings_out_of_range_are_refused(change, sentence):
    with pytest.raises(UserError, match=sentence):
        StaticConfig(**change)
