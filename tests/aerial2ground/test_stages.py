"""The stages one after another, and data sets that are not enough."""

import json
import shutil
from dataclasses import replace

import pytest

from aerial2ground.ground_views import load_views
from aerial2ground.pure_pursuit import PurePursuitConfig
from aerial2ground.stages import (
    load_network,
    load_survey,
    run_driving,
    run_ground_views,
    run_policies,
    unseen_road,
)
from hashnerf.errors import UserError


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


def test_views_policies_and_drives(tiny_run):
    calls = []
    run_ground_views(tiny_run, lambda done, total: calls.append((done, total)))
    assert calls[-1] == (18, 18)
    views = load_views(tiny_run.folder / "ground" / "outer_loop")
    assert views.pictures.shape == (6, 18, 32, 3) and abs(views.steering).max() <= tiny_run.car.steering_limit
    run_policies(tiny_run)
    network = load_network(tiny_run.folder / "policies" / "left_turns", tiny_run.imitation.task.network)
    assert (network.height, network.width) == (18, 32)
    table = run_driving(tiny_run, [0])
    assert set(table) == {"outer_loop", "left_turns", "right_turns"}
    expert = table["outer_loop"]["expert"]
    assert expert["interventions"] == 0 and expert["pos_m"] < 0.05
    saved = json.loads((tiny_run.folder / "driving.json").read_text())
    assert saved["table2"] == table and len(saved["tracks"]) == 6


def test_stages_in_the_wrong_order_name_the_script(tiny_run):
    with pytest.raises(UserError, match="run scripts/make_ground_views"):
        run_policies(tiny_run)
    with pytest.raises(UserError, match="run scripts/train_policy"):
        run_driving(tiny_run, [0])


def test_every_road_is_seen_and_a_shifted_one_is_not(tiny_run):
    survey = load_survey(tiny_run)
    assert unseen_road(survey.train.cameras, survey.network) < 0.05
    away = replace(survey.network, lines=tuple(line + 100 for line in survey.network.lines))
    assert unseen_road(survey.train.cameras, away) == 1.0


def far_away(document):
    network = document["road_network"]
    network["lines"] = [[[x + 500, y] for x, y in line] for line in network["lines"]]
    document["trajectories"] = {"far": network["lines"][0]}


@pytest.mark.parametrize(
    "change, sentence",
    [
        (lambda d: d.pop("road_network"), "has no road_network"),
        (lambda d: d.pop("trajectories"), "has no trajectories"),
        (far_away, "no picture shows any of the road network"),
        (lambda d: [f.update(split="test") for f in d["frames"][3:]], "has 3 training pictures, too few"),
    ],
)
def test_data_sets_that_are_not_enough(edited, change, sentence):
    with pytest.raises(UserError, match=sentence):
        load_survey(edited(change))


def test_a_path_shorter_than_the_look_ahead(tiny_run):
    with pytest.raises(UserError, match=r"shorter than pure_pursuit\.look_ahead"):
        load_survey(replace(tiny_run, pure_pursuit=PurePursuitConfig(look_ahead=50.0)))


def test_photographs_cannot_be_driven_in(edited):
    config = edited(lambda d: d.pop("world"))
    run_ground_views(config)
    run_policies(config)
    with pytest.raises(UserError, match="not rendered from an embedded world"):
        run_driving(config, [0])
