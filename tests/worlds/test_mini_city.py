"""The mini-city: deterministic, clear roads, and a deployment that differs only by what was asked."""

import numpy as np
import pytest

from hashnerf.errors import UserError
from worlds.mini_city import LAYOUTS, MiniCityConfig, build_mini_city
from worlds.mini_city_roads import on_road
from worlds.scene import Scene
from worlds.shading import Light

FLAT = {"floor", "lawn", "road", "pavement", "markings"}


def bodies(seed=0, **settings):
    return dict(build_mini_city(MiniCityConfig(**settings), seed).static)


@pytest.mark.parametrize("layout", range(LAYOUTS))
@pytest.mark.parametrize("seed", range(4))
def test_nothing_stands_on_a_road_even_after_it_was_moved(layout, seed):
    for displacement in (0.0, 0.05):
        for name, mesh in bodies(seed, layout=layout, displacement=displacement).items():
            if name not in FLAT:
                low = mesh.vertices[mesh.vertices[:, 2] < 0.25]  # a crown may hang over a road
                assert not on_road(low[:, :2].astype(float)).any(), name


def test_the_same_config_and_seed_give_the_same_town():
    one, two = bodies(3), bodies(3)
    assert list(one) == list(two)
    assert all(np.array_equal(one[name].vertices, two[name].vertices) for name in one)


def test_layouts_and_seeds_differ_in_what_stands_where():
    plans = [sorted(bodies(layout=layout)) for layout in range(LAYOUTS)]
    assert plans[0] != plans[1] != plans[2] != plans[0]
    assert sorted(bodies(0)) != sorted(bodies(1))
    assert all(sum(name.startswith("house") for name in plan) >= 4 for plan in plans)


def test_an_avenue_hangs_over_the_road_and_stands_beside_it():
    trees = {name: mesh for name, mesh in bodies(avenue=30).items() if "avenue" in name}
    assert 20 <= len(trees) <= 30 and not any("avenue" in name for name in bodies())
    for mesh in trees.values():
        place, height = mesh.vertices[:, :2].astype(float), mesh.vertices[:, 2]
        assert on_road(place[height > 0.4]).any(), "the crown"
        assert not on_road(place[height < 0.3]).any(), "the trunk"
    plain = bodies()
    assert all(np.array_equal(mesh.vertices, bodies(avenue=30)[name].vertices) for name, mesh in plain.items())


def test_displacement_moves_small_things_and_no_house():
    before, after = bodies(), bodies(displacement=0.05)
    assert list(before) == list(after)
    for name, mesh in before.items():
        moved = after[name].vertices - mesh.vertices
        if name.startswith(("tree", "lamp", "car")):
            assert 0 < np.abs(moved).max() <= 0.05 * 1.001 and moved.std(axis=0).max() < 1e-6, name
        else:
            assert not moved.any(), name


def test_the_sun_is_the_only_other_change():
    town, evening = (build_mini_city(MiniCityConfig(light=light), 0) for light in (Light(), Light(100.0, 30.0)))
    views = [Scene(world, {}).render(world.rig.cameras.scaled(60, 45), 0) for world in (town, evening)]
    assert np.array_equal(views[0].object_id, views[1].object_id) and (views[0].rgb != views[1].rgb).any()


@pytest.mark.parametrize("settings", [{"layout": 3}, {"layout": -1}, {"displacement": 0.5}, {"displacement": -0.1}])
def test_settings_out_of_range_are_refused(settings):
    with pytest.raises(UserError, match="mini_city"):
        MiniCityConfig(**settings)
