"""Rendered beliefs against the ground truth: the right camera, the right latents, honest columns."""

from dataclasses import replace

import pytest
import torch

from carff import evaluate_scenes as scenes
from carff.evaluate_scenes import comparison_camera, render_scenes, scene_latents, telling_view, trained_on, with_suffix
from carff.evaluation_data import PARTIAL

ALL = torch.arange(4)


@pytest.fixture
def held_out(tiny_evaluation, monkeypatch):
    """The field that never saw the bird's-eye camera, 0.1 too bright; the one that has is 0.05 too bright."""
    nerf = type(tiny_evaluation.model.nerf)(tiny_evaluation.data.images, tiny_evaluation.table.views, 0.1)
    monkeypatch.setattr(scenes, "load_nerf", lambda config, scene, held_out: (nerf, {}))
    return nerf


def test_both_columns_of_a_run_with_both_fields(tiny_evaluation, held_out):
    (tiny_evaluation.config.folder / "nerf_birds_eye").mkdir()
    part = scenes.evaluate_scenes(tiny_evaluation)
    nerf = part.results["nerf"]
    # 0.05 too bright: 10 log10(1 / 0.0025) = 26.0 dB; 0.1 too bright: 20 dB. Bytes round by 1/510.
    assert nerf["psnr_matched_db"] == pytest.approx(26.02, abs=0.4)
    assert nerf["psnr_matched_heldout_db"] == pytest.approx(20.0, abs=0.2)
    assert nerf["state_identified"] == nerf["state_identified_heldout"] == 1.0
    assert nerf["changed_px_lead_db"] > 5 and nerf["changed_px_lead_heldout_db"] > 3
    assert (nerf["camera"], nerf["camera_kind"], nerf["states"]) == (3, "birds_eye", 4)
    assert nerf["predicted"] == [False, True, False, True]
    assert set(part.figures) == {"psnr_matrix", "psnr_matrix_heldout"} and not part.not_run


def test_without_a_field_that_saw_the_camera_there_is_one_column_and_a_reason(tiny_evaluation, held_out):
    part = scenes.evaluate_scenes(tiny_evaluation)
    assert "psnr_matched_db" not in part.results["nerf"]
    assert part.results["nerf"]["psnr_matched_heldout_db"] > 19
    assert set(part.figures) == {"psnr_matrix_heldout"}
    assert "camera 3, which is held out" in part.not_run["nerf.psnr_matched_db"]
    assert "psnr_matrix" in part.not_run and "nerf.state_identified" in part.not_run


def test_a_field_that_always_shows_one_state_is_found_out(tiny_evaluation, held_out, monkeypatch):
    monkeypatch.setattr(held_out, "views", held_out.views[[0, 0, 0, 0]])
    nerf = scenes.evaluate_scenes(tiny_evaluation).results["nerf"]
    assert nerf["state_identified_heldout"] == 0.25


def test_states_without_a_picture_at_the_camera_are_left_out(tiny_evaluation, held_out):
    views = tiny_evaluation.table.views.clone()
    views[1, 3] = -1
    table = replace(tiny_evaluation.table, views=views)
    nerf = scenes.evaluate_scenes(replace(tiny_evaluation, table=table)).results["nerf"]
    assert nerf["states"] == 3 and len(nerf["psnr_matrix_heldout_db"]) == 3
    assert nerf["predicted"] == [False, False, True]


def test_first_states_are_toggled_and_the_others_forecast(tiny_evaluation):
    scene = scene_latents(tiny_evaluation, ALL)
    assert scene.predicted.tolist() == [False, True, False, True]
    assert scene.latents.argmax(dim=1).tolist() == [0, 1, 2, 3]


def test_where_no_view_settles_the_predecessor_a_sample_of_the_wanted_state_is_taken(tiny_evaluation):
    views = tiny_evaluation.views
    # Nothing settles the first states: every view of them believes evenly in both.
    open_ = (views.state == 0) | (views.state == 2)
    mean = torch.where(open_[:, None], torch.tensor([0.5, 0.0, 0.5, 0.0]), views.belief.mean)
    blurred = replace(views, determined=~open_, belief=replace(views.belief, mean=mean))
    scene = scene_latents(replace(tiny_evaluation, views=blurred), ALL)
    assert scene.latents[[1, 3]].argmax(dim=1).tolist() == [1, 3]


def test_a_telling_view_is_trained_on_determined_and_the_egos(tiny_evaluation):
    generator = torch.Generator().manual_seed(0)
    rows = {telling_view(tiny_evaluation, 2, generator) for _ in range(30)}
    views = tiny_evaluation.views
    assert {(int(views.state[row]), int(views.camera[row])) for row in rows} == {(2, 1)}
    # With camera 1 showing only a part, the bird's-eye camera is better, though it is not the ego's.
    level = torch.where(views.camera == 1, PARTIAL, views.visibility)
    partly = replace(tiny_evaluation, views=replace(views, visibility=level))
    rows = {telling_view(partly, 2, generator) for _ in range(30)}
    assert {int(views.camera[row]) for row in rows} == {3}


def test_a_state_that_only_test_cameras_show_is_still_shown(tiny_evaluation):
    views = replace(tiny_evaluation.views, train=tiny_evaluation.views.state != 2)
    row = telling_view(replace(tiny_evaluation, views=views), 2, torch.Generator().manual_seed(0))
    assert views.state[row] == 2


def test_without_birds_eye_the_test_camera_that_sees_most_change_is_compared(tiny_evaluation, monkeypatch):
    assert comparison_camera(tiny_evaluation) == 3
    scene = replace(tiny_evaluation.model.scene, camera_kinds=("ego", "ego", "ego", "elevated"))
    object.__setattr__(tiny_evaluation.model, "scene", scene)
    assert comparison_camera(tiny_evaluation) == 2, "the only test camera"
    views = tiny_evaluation.views
    two = replace(views, test=(views.camera == 0) | (views.camera == 1))
    assert comparison_camera(replace(tiny_evaluation, views=two)) == 1, "the truck never shows at camera 0"
    none = replace(views, test=torch.zeros_like(views.test))
    assert comparison_camera(replace(tiny_evaluation, views=none)) in (1, 2, 3)


def test_trained_on_needs_train_pictures_and_for_the_birds_eye_camera_its_own_field(tiny_evaluation):
    assert trained_on(tiny_evaluation, 1) and not trained_on(tiny_evaluation, 2)
    assert not trained_on(tiny_evaluation, 3)
    (tiny_evaluation.config.folder / "nerf_birds_eye").mkdir()
    assert trained_on(tiny_evaluation, 3)


def test_renderings_can_be_smaller(tiny_evaluation):
    class Sized(type(tiny_evaluation.model.nerf)):
        def picture(self, latent, cameras, index):
            return torch.full((cameras.height, cameras.width, 3), 2.0)

    nerf = Sized(tiny_evaluation.data.images, tiny_evaluation.table.views)
    small = render_scenes(nerf, tiny_evaluation, torch.eye(4)[:2], 0, width=8)
    assert small.shape == (2, 8, 8, 3) and (small == 255).all()
    assert render_scenes(nerf, tiny_evaluation, torch.eye(4)[:2], 0).shape == (2, 32, 32, 3)


def test_suffixes_go_before_the_unit():
    assert with_suffix("psnr_matched_db", "_heldout") == "psnr_matched_heldout_db"
    assert with_suffix("state_identified", "_heldout") == "state_identified_heldout"
