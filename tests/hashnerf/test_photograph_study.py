"""Quality against seconds on photographs: what is run, what is read, and what the page says."""

from dataclasses import replace

import pytest
import torch

from hashnerf import photograph_study, static_scene
from hashnerf.errors import UserError
from hashnerf.fit import FitConfig
from hashnerf.metrics import psnr
from hashnerf.photograph_study import (
    PhotographStudy,
    Point,
    best_exposure_psnr,
    exposure_words,
    read_point,
    run_study,
    study_table,
    write_study,
)
from hashnerf.static_scene import StaticConfig, train_static
from tests.hashnerf.posed_scene import posed_scene

POINT = Point(250, 100, 20.0, 600.0, 23.5, 19.5, 23.75, "capacity: few")


def test_every_size_at_every_length(tmp_path, monkeypatch):
    commands = []
    monkeypatch.setattr(photograph_study, "run_stage", lambda name, command, folder: commands.append(command))
    monkeypatch.setattr(photograph_study, "read_point", lambda folder: POINT)
    config = PhotographStudy(data="photos", runs=str(tmp_path), sizes=(250, 500), steps=(1, 2))
    assert len(run_study(config)) == 4
    texts = [" ".join(command) for command in commands]
    assert "--dataset photos" in texts[0] and "--name 250px_1 --image_size 250 --steps 1" in texts[0]
    assert "--name 500px_2 --image_size 500 --steps 2" in texts[3]


def test_a_run_is_read(tmp_path, monkeypatch):
    monkeypatch.setattr(static_scene, "load_posed_images", lambda folder, size: posed_scene())
    fit = FitConfig(rays=64, batch_samples=512)
    config = StaticConfig(runs=str(tmp_path), threads=1, test_every=0, steps=3, fit=fit)
    results = train_static(config)
    point = read_point(config.folder)
    assert (point.size, point.steps, point.psnr_db) == (24, 3, results["psnr_db"])
    assert point.exposure_db >= point.psnr_db - 1e-6 and point.seconds > 0


def test_the_best_exposure_makes_up_for_a_wrong_one():
    data = posed_scene()
    assert best_exposure_psnr(lambda own, index: own.images[index].float() / 510, data) > 100
    true = data.images[0].float() / 255
    assert psnr(true / 2, true) < 20


def test_a_black_rendering_has_no_exposure():
    data = posed_scene()
    assert best_exposure_psnr(lambda own, index: torch.zeros(own.images[index].shape), data) < 20


def test_the_page_says_when_the_target_is_reached_and_what_exposure_adds(tmp_path):
    points = [POINT, replace(POINT, steps=200, seconds=41.0, psnr_db=25.0, exposure_db=25.1)]
    points += [replace(POINT, size=500, seconds=90.0, psnr_db=23.9, exposure_db=24.0)]
    config = PhotographStudy(data="photos", page=str(tmp_path / "photographs.md"))
    write_study(points, config, "about")
    text = config.page and (tmp_path / "photographs.md").read_text()
    assert "250 px reaches 24 dB in 41 s" in text and "500 px does not reach 24 dB" in text
    assert "adds 0.25 dB at most: exposure is not modelled" in text
    assert (tmp_path / "photographs.png").stat().st_size > 1000
    assert study_table(points).rows[0][4:] == ("23.50 dB", "19.50 dB", "+0.25 dB")


def test_exposure_that_would_pay():
    assert "may pay" in exposure_words([replace(POINT, exposure_db=24.1)])


@pytest.mark.parametrize(
    ("change", "sentence"), [({}, "data is empty"), ({"data": "x", "sizes": ()}, "sizes and steps")]
)
def test_what_is_missing_is_named(change, sentence):
    with pytest.raises(UserError, match=sentence):
        PhotographStudy(**change)
