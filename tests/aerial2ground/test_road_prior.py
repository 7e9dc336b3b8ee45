"""What the road prior tells the fit."""

import pytest
import torch

from aerial2ground.road_network import read_road_network
from aerial2ground.road_prior import RoadPriorConfig, draw_prior
from hashnerf.errors import UserError

ENTRY = {"lines": [[[0, 0], [4, 0]]], "width": 1.0, "height": 0.5, "colour": [51, 102, 255]}
ROADS = read_road_network(ENTRY, torch.zeros(3, dtype=torch.float64), "x")


def draw(**changes):
    return draw_prior(ROADS, RoadPriorConfig(**changes), 2.5, 400, torch.Generator().manual_seed(0))


def test_rays_fall_on_the_road_from_a_known_height():
    batch = draw(start=0.35, grazing=0.0)
    assert (batch.rays.directions == torch.tensor([0.0, 0.0, -1.0])).all()
    assert batch.rays.origins[:, 2] == pytest.approx(0.85) and (batch.distance == 0.35).all()
    hit = batch.rays.origins + batch.distance[:, None] * batch.rays.directions
    assert (ROADS.distance(hit[:, :2]) <= 0.5001).all() and hit[:, 2] == pytest.approx(0.5, abs=1e-6)
    assert batch.rgb[0].tolist() == pytest.approx([0.2, 0.4, 1.0])


def test_k47_rays_of_the_prior_have_unit_directions(numeric_row):
    worst = max(float((draw(grazing=share).rays.directions.norm(dim=1) - 1).abs().max()) for share in (0.0, 0.5, 1.0))
    numeric_row("K47", "400 rays down on the road and along it: length of a direction from 1", worst, 1e-6)


def test_the_papers_rays_start_at_the_flying_height():
    batch = draw(start=0.0, grazing=0.0)
    assert batch.rays.origins[:, 2] == pytest.approx(3.0) and (batch.distance == 2.5).all()


def looking_along(batch):
    return batch.rays.directions[:, 2] > -0.99


def test_other_rays_look_along_the_road_from_within_the_free_space():
    batch = draw(grazing=0.5, car_height=0.25)
    along = looking_along(batch)
    assert 0.2 < along.float().mean() < 0.5, "half are tried, some leave the road"
    rays, distance = batch.rays.select(along), batch.distance[along]
    hit = rays.origins + distance[:, None] * rays.directions
    assert hit[:, 2] == pytest.approx(0.5, abs=1e-5)
    for share in torch.linspace(0, 0.99, 12):
        place = rays.origins + share * distance[:, None] * rays.directions
        assert (ROADS.distance(place[:, :2]) <= 0.5001).all(), "what stands beside the road could be in the way"
        assert (place[:, 2] > 0.5).all() and (place[:, 2] <= 0.75 + 1e-5).all()
    sideways = rays.directions[:, :2].norm(dim=1) / -rays.directions[:, 2]
    assert sideways.max() > 7 and sideways.max() <= 10.001
    assert (batch.distance[~along] == 0.35).all(), "the rest look down"


def test_nothing_looks_along_a_road_that_is_not_known_to_be_free():
    for changes in ({"free_space": False}, {"depth": False}, {"grazing": 0.0}):
        assert not looking_along(draw(**changes)).any()


def test_no_ray_looks_through_a_hill():
    hill = {"lines": [[[0, 0, 0], [2, 0, 0.3], [4, 0, 0]]], "width": 1.0, "colour": [0, 0, 0]}
    roads = read_road_network(hill, torch.zeros(3, dtype=torch.float64), "x")
    config = RoadPriorConfig(grazing=1.0)
    batch = draw_prior(roads, config, 2.5, 2000, torch.Generator().manual_seed(0))
    ends = batch.rays.origins + batch.distance[:, None] * batch.rays.directions
    along = looking_along(batch)
    assert along.any()
    for share in (0.3, 0.6, 0.9):
        place = ends[along] + share * (batch.rays.origins - ends)[along]
        assert (place[:, 2] - roads.heights_at(place[:, :2]) > -0.01).all()


def test_parts_can_be_switched_off():
    assert (draw(colour=False).weight == 0).all() and (draw(colour_weight=0.2).weight == 0.2).all()
    assert draw(depth=False).distance.isnan().all()
    assert not RoadPriorConfig(colour=False, depth=False, free_space=False).used
    assert not RoadPriorConfig(share=0.0).used and RoadPriorConfig(colour=False).used


def test_points_of_free_space_lie_between_road_and_car_height():
    empty = draw(margin=0.02, car_height=0.25).empty
    assert (empty[:, 2] >= 0.52 - 1e-6).all() and (empty[:, 2] <= 0.75 + 1e-6).all()
    assert float(empty[:, 2].mean()) == pytest.approx(0.635, abs=0.01)


@pytest.mark.parametrize(
    "changes",
    [
        {"share": -1.0},
        {"colour_weight": -0.1},
        {"start": float("nan")},
        {"grazing": 1.1},
        {"margin": 0.3, "car_height": 0.2},
    ],
)
def test_bad_settings_are_named(changes):
    with pytest.raises(UserError, match="road_prior"):
        RoadPriorConfig(**changes)
