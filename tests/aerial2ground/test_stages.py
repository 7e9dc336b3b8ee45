"""The stages one after another, and data sets that are not enough."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from aerial2ground.evaluation_stages import run_driving
from aerial2ground.ground_views import load_views
from aerial2ground.learning_stages import run_drives, run_localisers, run_policies
from aerial2ground.pure_pursuit import PurePursuitConfig
from aerial2ground.stages import (
    load_nerf,
    load_survey,
    run_ground_views,
    run_reconstruction,
    unseen_road,
)
from hashnerf.errors import UserError
from tests.hashnerf.refusals import refuses


@pytest.fixture
def edited(tiny_run, tmp_path):
    """Returns a function that changes a copy of the data set and gives a config for it."""

    def edit(change):
        folder = tmp_path / "edited"
        shutil.copytree(tiny_run.dataset, folder)
        document = json.loads((folder / "transforms.json").read_text())
        change(document)
        (folder / "transforms.json").write_text(json.dumps(document))
        return replace(tiny_run, dataset=str(folder))

    return edit


def test_ground_views_have_poses_and_labels(tiny_run):
    calls = []
    run_ground_views(tiny_run, lambda done, total: calls.append((done, total)))
    assert calls[-1] == (18, 18)
    views = load_views(tiny_run.folder / "ground" / "outer_loop")
    assert views.pictures.shape == (6, 18, 32, 3) and abs(views.steering).max() <= tiny_run.car.steering_limit


def test_views_of_the_true_town_need_no_field_and_are_not_mixed_with_its_views(tiny_run):
    run_ground_views(replace(tiny_run, name="truth"), of_truth=True)
    folder = tiny_run.folder.with_name("truth") / "ground" / "outer_loop"
    run_ground_views(tiny_run)
    field, truth = load_views(tiny_run.folder / "ground" / "outer_loop"), load_views(folder)
    assert np.allclose(field.poses, truth.poses) and np.allclose(field.steering, truth.steering)
    assert truth.pictures.shape == field.pictures.shape and (truth.pictures != field.pictures).any()
    with pytest.raises(UserError, match=r"--overwrite true"):
        run_ground_views(tiny_run, of_truth=True)


def test_without_a_world_there_is_no_true_view(edited):
    config = edited(lambda document: document.pop("world"))
    with pytest.raises(UserError, match="was not rendered from an embedded world; leave --of_truth out"):
        run_ground_views(config, of_truth=True)


def test_views_of_another_field_or_camera_are_refused_and_rendered_anew_when_asked(tiny_run):
    run_ground_views(tiny_run)
    picture = tiny_run.folder / "ground" / "outer_loop" / "images" / "00000.png"
    before = picture.read_bytes()
    with pytest.raises(UserError, match=r"imitation.views: 6 -> 7\); .*--overwrite true"):
        run_ground_views(replace(tiny_run, imitation=replace(tiny_run.imitation, views=7)))
    steps = tiny_run.reconstruction.steps + 5
    longer = replace(tiny_run, overwrite=True, reconstruction=replace(tiny_run.reconstruction, steps=steps))
    run_reconstruction(longer)
    with pytest.raises(UserError, match=r"reconstruction.weights: "):
        run_ground_views(replace(longer, overwrite=False))
    assert picture.read_bytes() == before
    run_ground_views(longer)
    assert picture.read_bytes() != before


def test_every_road_is_seen_and_a_shifted_one_is_not(tiny_run):
    survey = load_survey(tiny_run)
    box = survey.data.scene_box
    assert unseen_road(survey.train.cameras, survey.network, box) < 0.05
    away = replace(survey.network, lines=tuple(line + 100 for line in survey.network.lines))
    assert unseen_road(survey.train.cameras, away, box) == 1.0
    # oblique pictures show the horizon, and so whatever lies there
    assert unseen_road(survey.train.cameras, away, box + torch.tensor([100.0, 100.0, 0.0])) < 1.0
    below = replace(survey.network, height=-50.0)
    assert unseen_road(survey.train.cameras, below, box) < 0.05, "its height is the network's own affair"


def far_away(document):
    network = document["road_network"]
    network["lines"] = [[[x + 500, y] for x, y in line] for line in network["lines"]]
    document["trajectories"] = {"far": network["lines"][0]}


@pytest.mark.parametrize(
    "change, sentence",
    [
        (lambda d: d.pop("road_network"), "has no road_network"),
        (far_away, "no picture shows any of the road network"),
        (lambda d: [f.update(split="test") for f in d["frames"][3:]], "has 3 training pictures, too few"),
    ],
)
def test_k43_k47_data_sets_that_are_not_enough(edited, change, sentence, numeric_row):
    row = "K43" if "too few" in sentence else "K47"
    numeric_row(row, f"{sentence}: loaded, or not named", not refuses(sentence, load_survey, edited(change)))


def test_without_trajectories_there_is_a_field_but_nothing_to_drive(edited):
    config = edited(lambda d: d.pop("trajectories"))
    assert load_survey(config).trajectories == {}
    for stage in (run_ground_views, run_policies, run_localisers, run_drives, run_driving):
        with pytest.raises(UserError, match="has no trajectories; add"):
            stage(config)


def without_our_keys(document):
    for key in ("road_network", "trajectories", "world"):
        document.pop(key)
    for frame in document["frames"]:
        frame.pop("split", None)


def test_plain_photographs_with_roads_in_a_file_of_their_own(edited, tiny_run, tmp_path):
    told = load_survey(tiny_run)
    entry = json.loads((Path(tiny_run.dataset) / "transforms.json").read_text())["road_network"]
    (tmp_path / "roads.json").write_text(json.dumps(entry))
    config = edited(without_our_keys)
    assert len(load_survey(replace(config, road_network=str(tmp_path / "roads.json"))).test) == 0
    box = (-9.0, -9.0, -1.0, 9.0, 9.0, 2.0)
    config = replace(config, road_network=str(tmp_path / "roads.json"), test_every=8, scene_box=box)
    survey = load_survey(config)
    assert survey.network.length == told.network.length
    assert [row for row, frame in enumerate(survey.data.frames) if frame.split == "test"] == [0, 8, 16]
    assert survey.data.scene_box.tolist() == [[-9, -9, -1], [9, 9, 2]]
    with pytest.raises(UserError, match="no camera sees it"):
        load_survey(replace(config, scene_box=(0.0, 0.0, 900.0, 1.0, 1.0, 901.0)))


def test_splits_of_the_data_set_stay(tiny_run):
    told = [frame.split for frame in load_survey(tiny_run).data.frames]
    assert "test" in told
    assert [frame.split for frame in load_survey(replace(tiny_run, test_every=2)).data.frames] == told


def test_two_road_networks_are_one_too_many(tiny_run):
    with pytest.raises(UserError, match="has a road_network of its own"):
        load_survey(replace(tiny_run, road_network="roads.json"))


def test_a_path_shorter_than_the_look_ahead(tiny_run):
    with pytest.raises(UserError, match=r"shorter than pure_pursuit\.look_ahead"):
        load_survey(replace(tiny_run, pure_pursuit=PurePursuitConfig(look_ahead=50.0)))


def test_capacity_that_is_left_open_is_derived_once_and_found_again(tiny_run, capsys):
    own = tiny_run.reconstruction
    opened = replace(
        own,
        steps=2,
        field=replace(own.field, levels=0, log2_table_size=0, finest_resolution=0),
        occupancy=replace(own.occupancy, cell=0.0),
    )
    config = replace(tiny_run, name="opened", reconstruction=opened)
    run_reconstruction(config)
    assert "capacity: pixels cover" in capsys.readouterr().err
    survey = load_survey(config)
    nerf, _ = load_nerf(config, survey)
    chosen = nerf.config
    assert chosen.field.levels > 0 and chosen.occupancy.cell > 0 and chosen.march == own.march
    assert len(nerf.field.hash_grid.plan) == chosen.field.levels
    run_reconstruction(config)  # the same again is no other config
