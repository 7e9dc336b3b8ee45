"""The study of localisers: which networks, what they are tried on, what the page says."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from aerial2ground.evaluation_stages import test_drives as drives_of
from aerial2ground.localiser_study import (
    Case,
    Errors,
    Pictures,
    Trainer,
    cases,
    prepare,
    smallest_that_can,
    study_chart,
    study_table,
    words,
)
from aerial2ground.stages import load_driven_survey, run_ground_views
from hashnerf.errors import UserError
from hashnerf.figure_style import png_bytes


def test_every_number_of_views_and_every_size_is_tried():
    tried = cases([100, 400, 1200], [8, 16], most_of_field=400)
    field = [Case("field", 100, 8), Case("field", 400, 8), Case("field", 400, 16)]
    truth = [Case("truth", 100, 8), Case("truth", 400, 8), Case("truth", 1200, 8), Case("truth", 1200, 16)]
    assert tried == field + truth == cases([100, 400, 1200], [16, 8], most_of_field=400)
    assert cases([50], [8], most_of_field=6)[0] == Case("field", 6, 8), "fewer than asked for: what there is"
    for views, filters in (([], [8]), ([10], []), ([1], [8]), ([10], [0])):
        with pytest.raises(UserError, match="views"):
            cases(views, filters, 400)


def test_fewer_views_are_spread_over_the_same_path():
    one = torch.arange(10, dtype=torch.uint8)[:, None, None, None].expand(10, 2, 2, 3)
    poses = np.arange(30.0).reshape(10, 3)
    thin = Pictures((one,), (one[..., 0] == 0,), (poses,)).thinned(4)
    assert thin.pictures[0][:, 0, 0, 0].tolist() == [0, 3, 6, 9]
    assert thin.poses[0][:, 0].tolist() == [0, 9, 18, 27] and len(thin.sky[0]) == 4


def test_from_a_run_to_errors(tiny_run):
    run_ground_views(tiny_run)
    learn, elsewhere = prepare(replace(tiny_run), [5])
    paths = len(load_driven_survey(tiny_run).trajectories)
    assert [len(one) for one in learn["truth"].poses] == [5] * paths
    assert [len(one) for one in learn["field"].poses] == [tiny_run.imitation.views] * paths
    assert not np.allclose(elsewhere["truth"].poses[0][:5], learn["truth"].poses[0]), "other places"
    assert 0.05 < torch.cat(learn["truth"].sky).float().mean() < 0.7
    # one town: a blurred field is nearer to the truth at its place than to the truth elsewhere
    there = torch.cat(elsewhere["field"].pictures).float()
    same = (there - torch.cat(elsewhere["truth"].pictures).float()).square().mean()
    shuffled = torch.cat(elsewhere["truth"].pictures).float().roll(30, dims=0)
    assert same < (there - shuffled).square().mean()
    errors = Trainer(tiny_run, learn, elsewhere, drives_of(tiny_run))()(Case("truth", 4, 4))
    assert all(np.isfinite(value) for value in vars(errors).values()) and errors.now_deg <= 180


RESULTS = {
    Case("field", 100, 8): Errors(0.5, 9.0, 1.2, 40.0, 0.6),
    Case("field", 400, 8): Errors(0.35, 8.0, 0.9, 35.0, 0.4),
    Case("truth", 100, 8): Errors(0.6, 9.0, 0.7, 20.0, 0.4),
    Case("truth", 400, 8): Errors(0.2, 4.0, 0.28, 5.0, 0.1),
    Case("truth", 400, 16): Errors(0.1, 2.0, 0.15, 3.0, 0.08),
}


def test_the_smallest_network_that_can():
    assert smallest_that_can(RESULTS, 0.3) == {"field": None, "truth": Case("truth", 400, 8)}
    assert smallest_that_can(RESULTS, 1.0)["field"] == Case("field", 400, 8)
    assert words(None, 3) == "none" and words(Case("truth", 400, 8), 3) == "the one with 8 filters after 1200 views"


def test_table_and_chart():
    table = study_table(RESULTS, paths=3).splitlines()
    assert len(table) == 2 + len(RESULTS)
    assert table[2] == "| views of the field | 300 | 8 | 0.50 | 9.0 | 1.20 | 0.60 | 40.0 |"
    assert png_bytes(study_chart(RESULTS, 3, 0.3)).startswith(b"\x89PNG")
