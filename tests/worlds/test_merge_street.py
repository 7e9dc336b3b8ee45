import math

import numpy as np
import pytest

from worlds.merge_street import AREA, BEND, HEADING, RAMP_LENGTH, ego_route, ramp_point, street_bodies
from worlds.meshes import merge
from worlds.raycast import Caster


def test_ramp_points_by_hand():
    assert ramp_point(0.0) == pytest.approx(BEND)
    x, y = ramp_point(10.0)
    assert (x, y) == pytest.approx((BEND[0] - 10 * math.cos(HEADING), BEND[1] - 10 * math.sin(HEADING)))
    # Left of a car that drives up the ramp is towards -x.
    assert ramp_point(0.0, 1.0)[0] < BEND[0]


def test_the_route_turns_steadily_from_the_ramp_into_the_lane():
    route = ego_route()
    yaw = np.array([route.pose(s).yaw for s in np.arange(0.0, route.length, 0.5)])
    assert yaw[0] == pytest.approx(HEADING) and yaw[-1] == pytest.approx(0.0)
    assert (np.diff(yaw) <= 1e-9).all() and np.abs(np.diff(yaw)).max() < math.radians(12)
    at = route.pose(RAMP_LENGTH)
    assert (at.x, at.y) == pytest.approx(BEND)


@pytest.mark.parametrize("seed", [0, 1])
def test_wheels_stay_on_the_road_and_nothing_stands_in_the_way(seed):
    bodies = street_bodies(np.random.default_rng(seed), 1.0)
    caster = Caster([(1, merge([mesh for _, mesh in bodies]))])
    route = ego_route()
    poses = [route.pose(float(s)) for s in np.arange(0.5, route.length - 0.5, 0.5)]
    sides = (-0.9, 0.0, 0.9)
    spots = [(p.x - side * math.sin(p.yaw), p.y + side * math.cos(p.yaw)) for p in poses for side in sides]
    spots += [(x, y) for x in np.arange(AREA[0] + 1, AREA[2] - 1, 1.0) for y in sides]
    origins = np.array([(x, y, 20.0) for x, y in spots], np.float32)
    distance, _ = caster.cast(origins, np.tile(np.array([[0, 0, -1]], np.float32), (len(origins), 1)))
    np.testing.assert_allclose(distance, 20.0, atol=0.02)
