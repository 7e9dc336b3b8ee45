"""Accuracy of naming states and reconstruction quality, on a run that knows everything."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from carff.beliefs import Belief, reparameterise
from carff.evaluate_beliefs import (
    decoded_psnr,
    describe_data,
    evaluate_beliefs,
    other_cameras,
    read_curve,
    reconstruction_scores,
    svm_scores,
)
from carff.latent_metrics import svm_accuracy


def test_ceilings_count_what_the_pixels_allow(tiny_evaluation):
    scores, reasons = svm_scores(tiny_evaluation.beliefs)
    # Train cameras 0, 1, 3: camera 0 shows two states per picture (4 views worth 1/2), 1 and 3 one (8 views): 10 of 12.
    assert scores["svm_ceiling"] == pytest.approx(10 / 12)
    assert scores["svm_visible_ceiling"] == 1.0, "the truck is visible only in pictures of one state"
    assert scores["svm_visible_heldout_ceiling"] == 1.0
    assert not reasons


def test_ceilings_of_visible_views_count_only_those_views(tiny_evaluation):
    groups = tiny_evaluation.groups.clone()
    groups[:, 1] = 0  # as if camera 1 saw the same in all four states
    scores, _ = svm_scores(replace(tiny_evaluation.beliefs, groups=groups))
    # Cameras 1 and 3 show the truck in states 2 and 3: of camera 1's two views one can be right, of camera 3's both.
    assert scores["svm_visible_ceiling"] == pytest.approx(3 / 4)


def test_scores_of_a_run_that_knows_everything(tiny_evaluation):
    scores, _ = svm_scores(tiny_evaluation.beliefs)
    assert scores["svm_visible"] == scores["svm_determined"] == 1.0
    assert (scores["svm_visible_count"], scores["svm_determined_count"], scores["svm_all_count"]) == (4, 8, 12)
    assert scores["svm_heldout"] == scores["svm_visible_heldout"] == 1.0
    # at most one of two equal pictures can be named
    assert 8 / 12 <= scores["svm_all"] <= 10 / 12


def test_equal_pictures_are_kept_in_one_fold(tiny_evaluation, monkeypatch):
    given = {}

    def recorded(latents, labels, groups):
        given.update(groups=groups)
        return svm_accuracy(latents, labels, groups)

    monkeypatch.setattr("carff.evaluate_beliefs.svm_accuracy", recorded)
    svm_scores(tiny_evaluation.beliefs)
    train = tiny_evaluation.views.select(tiny_evaluation.views.train)
    assert (given["groups"] == train.picture.numpy()).all()


def test_scores_see_a_belief_that_says_nothing(tiny_evaluation):
    blank = Belief(torch.zeros(16, 4), torch.zeros(16, 4))
    scores, _ = svm_scores(replace(tiny_evaluation.beliefs, views=replace(tiny_evaluation.views, belief=blank)))
    assert scores["svm_all"] <= 0.5


def test_missing_scores_come_with_a_reason(tiny_evaluation):
    views = tiny_evaluation.views
    none = torch.zeros(16, dtype=torch.bool)
    _, reasons = svm_scores(replace(tiny_evaluation.beliefs, views=replace(views, shows_actor=none)))
    figures = {"pcvae.svm_visible", "pcvae.svm_visible_heldout"}
    assert set(reasons) == figures | {f"{figure}_gap" for figure in figures}
    one_state = replace(views, state=torch.zeros_like(views.state))
    scores, reasons = svm_scores(replace(tiny_evaluation.beliefs, views=one_state))
    assert "svm_all" not in scores
    assert "at least two states" in reasons["pcvae.svm_all"]


@pytest.mark.filterwarnings("error")
def test_data_without_test_cameras_has_no_figure_for_them_and_no_warning(tiny_evaluation):
    none = torch.zeros(16, dtype=torch.bool)
    evaluation = replace(tiny_evaluation, views=replace(tiny_evaluation.views, test=none))
    scores = reconstruction_scores(evaluation.beliefs, torch.zeros(16, tiny_evaluation.views.belief.mean.shape[1]))
    assert scores["psnr_heldout_db"] is None and scores["psnr_heldout_of_mean_mse_db"] is None
    assert scores["psnr_train_of_mean_mse_db"] is not None


def test_reconstructions_are_scored_at_another_camera_of_the_same_state(tiny_evaluation):
    views = tiny_evaluation.views
    clear = views.select(views.determined)
    whole, changed, _ = decoded_psnr(tiny_evaluation.beliefs, clear, clear.belief.mean)
    # The decoder is 0.1 too dark everywhere: 10 log10(1 / 0.01) = 20 dB, on changed pixels too.
    assert whole == pytest.approx(np.full(12, 20.0), abs=1e-3)
    assert changed == pytest.approx(np.full(12, 20.0), abs=1e-3)


def test_the_mean_picture_is_a_baseline_by_hand(tiny_evaluation):
    views = tiny_evaluation.views.select(tiny_evaluation.views.camera == 1)
    _, _, baseline = decoded_psnr(tiny_evaluation.beliefs, views, views.belief.mean)
    index = other_cameras(
        tiny_evaluation.table.view_index("train"), views.state, views.camera, tiny_evaluation.generator(3)
    )
    for row, (state, camera) in enumerate(zip(views.state.tolist(), index.tolist())):
        pictures = tiny_evaluation.data.images[tiny_evaluation.table.views[:, camera]].double() / 255
        error = ((pictures.mean(dim=0) - pictures[state]) ** 2).mean()
        assert baseline[row] == pytest.approx(float(-10 * torch.log10(error)), abs=1e-3)


def test_a_camera_without_change_has_no_changed_pixels(tiny_evaluation):
    images = tiny_evaluation.data.images.clone()
    still = tiny_evaluation.table.views[:, [0, 1]].flatten()
    images[still] = 77
    data = replace(tiny_evaluation.data, images=images)
    views = tiny_evaluation.views.select(tiny_evaluation.views.camera == 3)  # decoded at camera 0 or 1
    _, changed, _ = decoded_psnr(replace(tiny_evaluation.beliefs, data=data), views, views.belief.mean)
    assert np.isnan(changed).all()
    samples = reparameterise(tiny_evaluation.views.belief)
    scores = reconstruction_scores(replace(tiny_evaluation.beliefs, data=data), samples)
    assert scores["changed_px_db"] is None or np.isfinite(scores["changed_px_db"])


def test_other_cameras_are_never_the_encoders_own():
    index = torch.tensor([[0, 1, -1, 2], [3, -1, -1, -1]])
    state, camera = torch.tensor([0, 0, 1]).repeat(50), torch.tensor([0, 3, 0]).repeat(50)
    drawn = other_cameras(index, state, camera, torch.Generator().manual_seed(0)).reshape(50, 3)
    assert set(drawn[:, 0].tolist()) == {1, 3} and set(drawn[:, 1].tolist()) == {0, 1}
    assert set(drawn[:, 2].tolist()) == {0}, "state 1 has one picture only"


def test_training_curve_skips_lines_without_a_value(tmp_path):
    path = tmp_path / "metrics.jsonl"
    lines = [{"seconds": 1.5, "psnr": 20.0}, {"seconds": 2.0, "psnr": None}, {"seconds": 3.0, "psnr": 25.5}]
    path.write_text("\n".join(json.dumps(line) for line in lines) + "\n")
    assert read_curve(path).tolist() == [[1.5, 20.0], [3.0, 25.5]]
    assert read_curve(tmp_path / "missing.jsonl").shape == (0, 2)


def test_the_part_describes_the_data_and_draws_what_it_can(tiny_evaluation):
    assert describe_data(tiny_evaluation) == {
        "states": 4, "branches": ["absent", "present"], "cameras": 4, "test_cameras": 1, "views": 16,
        "image_size": [32, 32], "determined_views": 12, "ambiguous_views": 4,
    }  # fmt: skip
    part = evaluate_beliefs(tiny_evaluation)
    assert set(part.figures) == {"contact_sheet", "reconstructions", "tsne"}
    assert "metrics.jsonl" in part.not_run["psnr_train"]
    folder = tiny_evaluation.config.folder / "pcvae"
    folder.mkdir()
    (folder / "metrics.jsonl").write_text('{"seconds": 1.0, "psnr": 20.0}\n{"seconds": 2.0, "psnr": 21.0}\n')
    assert "psnr_train" in evaluate_beliefs(tiny_evaluation).figures
