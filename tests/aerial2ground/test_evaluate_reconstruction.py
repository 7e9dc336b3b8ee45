"""Measures of a reconstruction against the truth that the embedded town gives."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from aerial2ground import evaluate_reconstruction as module
from aerial2ground.car_camera import car_cameras
from aerial2ground.evaluate_reconstruction import (
    aerial_psnr,
    aligned_poses,
    evaluate_run,
    ground_errors,
    refined_pose_errors,
    true_poses,
    view_milliseconds,
)
from aerial2ground.stages import load_nerf, load_survey
from hashnerf.errors import UserError
from worlds.scenarios import world_from_description


@pytest.fixture
def trained(tiny_run):
    survey = load_survey(tiny_run)
    return tiny_run, survey, load_nerf(tiny_run, survey)[0]


def test_poses_of_held_out_pictures_are_found_again(trained):
    _, survey, nerf = trained
    test = survey.test
    wrong = test.cameras.pose.clone()
    wrong[:, :2, 3] += 0.3
    moved = replace(test, cameras=replace(test.cameras, pose=wrong))
    aligned = aligned_poses(nerf, moved)
    told, before, after = (aerial_psnr(nerf, test, poses) for poses in (test.cameras.pose, wrong, aligned))
    assert before < told and after > before + 0.3 * (told - before)
    assert all(parameter.requires_grad for parameter in nerf.parameters())


def test_told_poses_are_as_wrong_as_the_survey_made_them(trained):
    config, survey, nerf = trained
    truth = true_poses(Path(config.dataset), survey.train)
    errors = refined_pose_errors(nerf, survey.train, truth)
    # 3 mm and 0.2 degrees on each of three axes
    assert errors["told_m"] == pytest.approx(0.003 * 3**0.5, rel=0.3)
    assert errors["told_deg"] == pytest.approx(0.2 * 3**0.5, rel=0.3)
    assert set(errors) == {"told_m", "told_deg", "refined_m", "refined_deg"}


def test_ground_views_are_compared_with_the_town(trained):
    config, survey, nerf = trained
    world = world_from_description(survey.data.extras["world"])
    path = survey.trajectories["outer_loop"]
    errors, pairs = ground_errors(nerf, world, config.camera, path.poses(np.array([1.0, 4.0])))
    assert len(pairs) == 2 and pairs[0][0].shape == pairs[0][1].shape == (18, 32, 3)
    assert 5 < errors["psnr_db"] < 40 and errors["road_depth_rmse_m"] is not None


def test_the_time_of_a_view_is_a_median_without_the_first(trained):
    config, survey, nerf = trained
    cameras = car_cameras(config.camera, torch.from_numpy(survey.trajectories["outer_loop"].poses(np.arange(4.0))))
    ticks = iter([0.0, 9.0, 10.0, 10.5, 11.0, 11.2, 12.0, 12.3])  # seconds: 9, then 0.5, 0.2, 0.3
    assert view_milliseconds(nerf, cameras, lambda: next(ticks)) == pytest.approx(300)


def test_the_truth_follows_the_pictures(trained):
    config, survey, _ = trained
    rows = true_poses(Path(config.dataset), survey.test)
    assert torch.allclose(rows[:, :3, 3], survey.test.cameras.pose[:, :3, 3], atol=0.02)


def test_a_run_is_measured_into_its_folder(tiny_run, monkeypatch):
    monkeypatch.setattr(module, "GROUND_VIEWS", 3)
    monkeypatch.setattr(module, "ALIGN_STEPS", 2)
    results = evaluate_run(tiny_run)
    assert json.loads((tiny_run.folder / "reconstruction.json").read_text()) == results
    assert results["test_pictures"] == 3 and results["aerial_psnr_db"] > 10
    assert results["poses"]["told_m"] > 0 and results["ground"]["road_psnr_db"] > 5
    assert Image.open(tiny_run.folder / "ground_views.png").size == (3 * 32, 3 * 36)


def test_held_out_figures_stay_while_the_field_is_the_same(tiny_run, monkeypatch):
    monkeypatch.setattr(module, "GROUND_VIEWS", 3)
    monkeypatch.setattr(module, "ALIGN_STEPS", 2)
    assert "aerial_psnr_db" not in evaluate_run(tiny_run, aerial=False)
    assert "--aerial false" in evaluate_run(tiny_run, aerial=False)["not_run"]["nerf.aerial_heldout_psnr_db"]
    whole = evaluate_run(tiny_run)
    again = evaluate_run(tiny_run, aerial=False)
    assert again.pop("view_ms") > 0 and whole.pop("view_ms") > 0  # times, which are never equal
    assert again == whole
    monkeypatch.setattr(module, "weights_digest", lambda folder: "another")
    assert "aerial_psnr_db" not in evaluate_run(tiny_run, aerial=False)


@pytest.mark.parametrize("content", ["{}", '{"poses": [[1, 2], [3]]}', '{"poses": "x"}', '{"poses": []}'])
def test_a_truth_that_is_none_is_named(tiny_run, tmp_path, content):
    data = load_survey(tiny_run).train
    (tmp_path / "truth.json").write_text(content)
    with pytest.raises(UserError, match=r"truth.json: does not hold a 4 x 4 pose of every camera"):
        true_poses(tmp_path, data)
