"""The two example pictures and their sampled futures."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from carff import evaluate_futures as futures_part
from carff.evaluate_futures import evaluate_futures, example_view, futures_of, named_as, shown_cameras, shrunk


def row_of(evaluation, state: int, camera: int) -> int:
    views = evaluation.views
    return int(((views.state == state) & (views.camera == camera)).nonzero()[0, 0])


def test_futures_of_an_occluded_picture(tiny_evaluation):
    futures = futures_of(tiny_evaluation, row_of(tiny_evaluation, 0, 0))
    assert futures.true_states == (1, 3) and futures.true_probability == (0.5, 0.5)
    assert futures.view_names == ("bird's-eye 3", "ego 1")
    assert futures.true_pictures.shape == (2, 2, 32, 32, 3)
    assert futures.sampled_pictures.shape == (5, 2, 32, 32, 3)
    assert set(futures.sampled_states) <= {1, 3} and len(futures.sampled_states) == 5
    assert sum(futures.state_probability) == pytest.approx(1) and futures.state_probability[4] == 0
    assert 0.3 < futures.state_probability[3] < 0.7  # 4 standard deviations of 100 draws around one half
    # what is shown is what was sampled: the renderer shows the state's own picture, 0.05 (13 levels) too bright
    truth = tiny_evaluation.pictures_at(3)[futures.sampled_states[0]].astype(int)
    assert np.abs(futures.sampled_pictures[0, 0].astype(int) - truth - 12.75).max() <= 1


def test_futures_happen_as_often_as_their_branches(tiny_evaluation):
    weighed = replace(tiny_evaluation.table, branch_weight=torch.tensor([0.25, 0.75]))
    futures = futures_of(replace(tiny_evaluation, table=weighed), row_of(tiny_evaluation, 0, 0))
    assert futures.true_states == (1, 3) and futures.true_probability == (0.25, 0.75)


def test_an_answer_that_stands_for_several_states_is_named_as_the_one_that_may_follow():
    same_boxes = torch.tensor([0, 0, 2, 3])  # states 0 and 1 look alike to the probe, which answers 0
    named = named_as(torch.tensor([0, 2, -1, 3]), torch.tensor([1, 3]), same_boxes)
    assert named.tolist() == [1, 2, -1, 3]
    assert named_as(torch.tensor([0]), torch.tensor([0, 1]), same_boxes).tolist() == [0], "the first of several"


def test_a_future_that_the_probe_cannot_read_counts_as_unknown(tiny_evaluation, monkeypatch):
    monkeypatch.setattr(
        type(tiny_evaluation.model), "probe_latents", lambda self, latents: torch.full((len(latents),), -1)
    )
    futures = futures_of(tiny_evaluation, row_of(tiny_evaluation, 0, 1))
    assert futures.state_probability == (0.0, 0.0, 0.0, 0.0, 1.0) and futures.sampled_states == (-1,) * 5


def test_examples_prefer_unseen_ego_pictures(tiny_evaluation):
    views = tiny_evaluation.views
    everything = torch.ones(16, dtype=torch.bool)
    assert views.camera[example_view(tiny_evaluation, everything)] == 2
    assert views.camera[example_view(tiny_evaluation, views.camera != 2)] in (0, 1)
    assert views.camera[example_view(tiny_evaluation, views.camera == 3)] == 3
    assert example_view(tiny_evaluation, ~everything) is None


def test_cameras_shown_are_the_birds_eye_and_the_ego_camera_that_shows_most(tiny_evaluation):
    assert shown_cameras(tiny_evaluation, [3]) == [3, 1]
    pixels = tiny_evaluation.table.visible_px.clone()
    pixels[3, 2] += 50
    assert shown_cameras(replace(tiny_evaluation, table=replace(tiny_evaluation.table, visible_px=pixels)), [3]) == [
        3,
        2,
    ]


def test_both_kinds_are_drawn_or_excused(tiny_evaluation):
    assert set(evaluate_futures(tiny_evaluation).figures) == {"futures_clear", "futures_occluded"}
    views = tiny_evaluation.views
    clear = replace(tiny_evaluation, views=views.select(views.camera != 0))
    part = evaluate_futures(clear)
    assert set(part.figures) == {"futures_clear"} and set(part.not_run) == {"futures_occluded"}
    hidden = replace(tiny_evaluation, views=views.select(views.camera == 0))
    assert set(evaluate_futures(hidden).not_run) == {"futures_clear"}


def test_a_picture_shared_with_a_last_step_still_settles_what_comes_next(tiny_evaluation):
    views = tiny_evaluation.views
    # As if nothing moved in the absent branch: both its steps give the same picture, and only the first goes on.
    picture = views.picture.clone()
    for camera in range(1, 4):
        at = [row_of(tiny_evaluation, state, camera) for state in (0, 1)]
        picture[at[1]] = picture[at[0]]
    still = replace(
        views, picture=picture, determined=views.determined & (views.state > 1), shows_actor=views.ego & False
    )
    only = replace(tiny_evaluation, views=still.select(still.state < 2))
    assert set(evaluate_futures(only).figures) >= {"futures_clear"}


def test_truth_is_shrunk_to_what_is_rendered(monkeypatch):
    monkeypatch.setattr(futures_part, "SHOWN_WIDTH", 4)
    pictures = np.zeros((2, 4, 8, 3), dtype=np.uint8)
    pictures[:, :, ::2] = 100
    assert shrunk(pictures).shape == (2, 2, 4, 3) and (shrunk(pictures) == 50).all(), "area means of 0 and 100"
    assert shrunk(pictures[:, :, :3]) is not None and shrunk(pictures[:, :, :3]).shape == (2, 4, 3, 3)
