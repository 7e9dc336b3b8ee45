"""The reconstruction: rays of pictures as cameras make them, and a training that learns and corrects poses."""

import math
from dataclasses import replace

import pytest
import torch

from aerial2ground.pose_refinement import PoseCorrections
from aerial2ground.reconstruction import ReconstructionConfig
from aerial2ground.stages import load_nerf, load_survey, new_nerf, run_reconstruction
from hashnerf.errors import UserError
from hashnerf.picture_rays import PictureRays


def test_corrected_poses_move_the_rays_and_have_gradients(tiny_run):
    data = load_survey(tiny_run).train
    pictures, corrections = PictureRays.of(data), PoseCorrections(len(data))
    number, pixel = torch.tensor([0, 1]), torch.tensor([5, 9])
    rays, _ = pictures.rays(number, pixel, corrections)
    (rays.origins.sum() + (rays.directions * torch.tensor([1.0, 2.0, 3.0])).sum()).backward()
    assert corrections.translation.grad.abs().max() > 0 and corrections.rotation.grad.abs().max() > 0


def test_training_learns_and_corrects_poses(tiny_run):
    survey = load_survey(tiny_run)
    nerf, cost = load_nerf(tiny_run, survey)
    fresh = new_nerf(tiny_run, survey.data.scene_box, len(survey.train))

    def error(one) -> float:
        seen = torch.stack([one.view(survey.test.cameras, row).rgb for row in range(len(survey.test))])
        return float((seen - survey.test.images.view(*seen.shape).float() / 255).square().mean())

    assert error(nerf) < 0.6 * error(fresh)
    assert nerf.corrections.translation.abs().max() > 0 and cost["seconds"] > 0


def test_views_from_stored_densities_are_those_of_the_field(tiny_run, monkeypatch):
    survey = load_survey(tiny_run)
    nerf, _ = load_nerf(tiny_run, survey)
    guided = replace(nerf.config.march, guided_per_opacity=8.0, samples=64)
    nerf.config = replace(nerf.config, march=guided, view_parts=4, view_samples_per_opacity=8.0)
    asked = nerf.view(survey.test.cameras, 0)
    nerf.bake(10**9)
    monkeypatch.setattr(nerf.field, "density", lambda positions: pytest.fail("the field was asked for its density"))
    stored = nerf.view(survey.test.cameras, 0)
    assert float((stored.rgb - asked.rgb).square().mean()) < 1e-4
    assert not torch.equal(stored.rgb, asked.rgb)


def test_nothing_is_stored_where_nothing_is_guided(tiny_run):
    nerf, _ = load_nerf(tiny_run, load_survey(tiny_run))
    nerf.config = replace(nerf.config, view_parts=4, march=replace(nerf.config.march, guided_per_opacity=0.0))
    nerf.bake(10**9)
    assert nerf.baked is None


def test_a_few_views_are_not_worth_storing_densities(tiny_run):
    nerf, _ = load_nerf(tiny_run, load_survey(tiny_run))
    march = replace(nerf.config.march, guided_per_opacity=8.0, samples_per_opacity=4.0)
    nerf.config = replace(nerf.config, view_parts=3, march=march)
    questions = int(nerf.occupancy.occupied().sum()) * 3 * 3 * 3
    nerf.bake(questions // 4)
    assert nerf.baked is None
    nerf.bake(questions // 4 + 1)
    assert nerf.baked is not None


def test_told_poses_can_be_kept(tiny_run):
    config = replace(
        tiny_run, name="kept", reconstruction=replace(tiny_run.reconstruction, refine_poses=False, steps=3)
    )
    run_reconstruction(config)
    nerf, _ = load_nerf(config, load_survey(config))
    assert not nerf.corrections.translation.any() and not nerf.corrections.rotation.any()


def test_a_finished_training_is_left_alone_and_another_config_refused(tiny_run, capsys):
    run_reconstruction(tiny_run)
    assert "already finished" in "".join(capsys.readouterr())
    other = replace(tiny_run, reconstruction=replace(tiny_run.reconstruction, position_learning_rate=0.5))
    with pytest.raises(UserError, match="position_learning_rate"):
        run_reconstruction(other)


def test_how_views_are_rendered_may_change_after_training(tiny_run):
    finer = replace(tiny_run, reconstruction=replace(tiny_run.reconstruction, view_supersample=2, view_parts=2))
    run_reconstruction(finer)  # would be refused if the field's record held them
    survey = load_survey(tiny_run)
    once, twice = (load_nerf(config, survey)[0].view(survey.test.cameras, 0) for config in (tiny_run, finer))
    assert once.rgb.shape == twice.rgb.shape and not torch.equal(once.rgb, twice.rgb)
    assert once.samples_evaluated < twice.samples_evaluated


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("view_supersample", 0),
        ("steps", 0),
        ("save_every", 0),
        ("view_parts", -1),
        ("position_learning_rate", 0.0),
        ("orientation_learning_rate", math.inf),
    ],
)
def test_bad_settings_are_named(key, value):
    with pytest.raises(UserError, match=f"reconstruction.{key} is"):
        ReconstructionConfig(**{key: value})
