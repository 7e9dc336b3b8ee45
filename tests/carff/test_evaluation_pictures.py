"""Which pictures the report shows."""

from dataclasses import replace

import torch

from carff.beliefs import reparameterise
from carff.evaluation_data import FULL, NONE, PARTIAL
from carff.evaluation_pictures import (
    camera_name,
    contact_sheet_figure,
    example_views,
    reconstruction_figure,
    sheet_cameras,
    target_cameras,
)
from hashnerf.figure_style import png_bytes

PNG = b"\x89PNG"


def test_sheet_runs_from_cameras_that_show_little_to_those_that_show_much(tiny_evaluation):
    views = tiny_evaluation.views
    # Of the ego cameras, 2 shows nothing, 0 a part and 1 everything; camera 3 is no ego camera and comes last.
    level = torch.tensor([PARTIAL, FULL, NONE, FULL])[views.camera]
    assert sheet_cameras(replace(views, visibility=level), 4) == [2, 0, 1, 3]


def test_sheet_takes_a_few_of_many_cameras(tiny_evaluation):
    views = tiny_evaluation.views
    many = replace(views, camera=torch.arange(16), ego=torch.arange(16) < 12, visibility=torch.zeros(16).long())
    chosen = sheet_cameras(many, 16)
    # 5 of the ego's 0..11 (every 2.75th) and 3 of the others 12..15
    assert chosen == [0, 3, 6, 8, 11, 12, 14, 15]


def test_names_say_kind_number_and_whether_the_camera_was_held_out(tiny_evaluation):
    assert camera_name(tiny_evaluation, 1) == "ego 1"
    assert camera_name(tiny_evaluation, 2) == "ego 2 (test)"
    assert camera_name(tiny_evaluation, 3) == "bird's-eye 3"


def test_targets_start_at_the_last_camera_and_never_hold_the_encoders_own():
    trained = torch.tensor([3, 1, -1, 4, 7, 2])
    assert target_cameras(trained, camera=4, count=3).tolist() == [5, 1, 0]  # of 5, 3, 1, 0; place 1.5 rounds to even
    assert target_cameras(trained, camera=5, count=9).tolist() == [4, 3, 1, 0]
    assert target_cameras(torch.tensor([0, -1]), camera=0).tolist() == [0], "its own, where there is no other"


def test_examples_are_a_known_an_unseen_and_an_ambiguous_view(tiny_evaluation):
    views = tiny_evaluation.views
    known, unseen = example_views(views)  # the only ambiguous views are not unseen here
    assert views.train[known] and views.determined[known] and views.ego[known]
    assert views.test[unseen] and views.determined[unseen]
    all_unseen = replace(views, test=torch.ones_like(views.test))
    assert [bool(views.determined[row]) for row in example_views(all_unseen)] == [True, True, False]


def test_figures_are_drawn_with_and_without_visibility(tiny_evaluation):
    samples = reparameterise(tiny_evaluation.views.belief)
    assert png_bytes(reconstruction_figure(tiny_evaluation, samples)).startswith(PNG)
    assert png_bytes(contact_sheet_figure(tiny_evaluation)).startswith(PNG)
    unknown = replace(tiny_evaluation.table, visible_px=torch.full_like(tiny_evaluation.table.visible_px, -1))
    assert png_bytes(contact_sheet_figure(replace(tiny_evaluation, table=unknown))).startswith(PNG)
