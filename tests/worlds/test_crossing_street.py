import numpy as np
import pytest

from worlds.crossing import EGO_ROUTE, EGO_SIZE, TRUCK_ROUTE
from worlds.crossing_street import SCENE_BOX, STOP_LINE, street_bodies
from worlds.meshes import merge


def bodies(seed=0, jitter=1.0, parked=True):
    return dict(street_bodies(np.random.default_rng(seed), jitter, parked))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_nothing_stands_in_the_lanes(seed):
    tall = merge([mesh for name, mesh in bodies(seed).items() if name not in ("ground", "marks")])
    corners = tall.vertices[tall.faces]
    low, high = corners.min(1), corners.max(1)
    for route, half in ((EGO_ROUTE, EGO_SIZE[1] / 2), (TRUCK_ROUTE, 1.2)):
        start, end = route.pose(0.0), route.pose(route.length)
        lane_low = np.minimum([start.x, start.y], [end.x, end.y]) - half
        lane_high = np.maximum([start.x, start.y], [end.x, end.y]) + half
        inside = ((high[:, :2] > lane_low) & (low[:, :2] < lane_high)).all(1)
        assert not inside.any()


def test_without_parked_cars_nothing_else_changes():
    full, empty = bodies(), bodies(parked=False)
    assert set(full) - set(empty) == {"parked_van", "parked_car_0", "parked_car_1"}
    for name, mesh in empty.items():
        np.testing.assert_array_equal(mesh.vertices, full[name].vertices)


def test_without_jitter_every_seed_gives_the_same_buildings_but_for_their_paint():
    one, two = bodies(0, jitter=0.0), bodies(1, jitter=0.0)
    for name in ("building_nw", "building_se"):
        np.testing.assert_array_equal(one[name].vertices, two[name].vertices)


def test_the_stop_line_is_painted_where_it_is_said_to_be():
    marks = bodies()["marks"]
    corners = marks.vertices[marks.faces].reshape(-1, 9)
    assert (np.abs(corners[:, 0::3].min(1) - STOP_LINE) < 1e-5).any()
    assert (bodies()["ground"].bounds[:, :2] == SCENE_BOX[:, :2]).all()
