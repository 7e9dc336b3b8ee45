import math

import numpy as np
import pytest

from worlds.boxes import box_at
from worlds.crossing import (
    EGO_ROUTE,
    EGO_SIZE,
    TRUCK_ROUTE,
    crossing_actors,
    crossing_mount,
    crossing_traffic,
    ego_pose,
    truck_pose,
)
from worlds.scene import State
from worlds.settings import EgoCameraConfig


def test_poses_lie_on_the_routes():
    for pose, route in ((ego_pose(-12.0), EGO_ROUTE), (truck_pose(9.0), TRUCK_ROUTE)):
        at = route.pose(route.nearest(pose.x, pose.y))
        assert (at.x, at.y, at.yaw) == pytest.approx((pose.x, pose.y, pose.yaw))


def test_the_truck_shrinks_by_at_most_three_percent():
    full = np.array((6.0, 2.4, 2.8))
    for seed in range(5):
        size = np.array(crossing_actors((6.0, 2.4, 2.8), 1.0, np.random.default_rng(seed))["truck"].size)
        assert (size <= full).all() and (size >= 0.97 * full - 1e-3).all()
    assert crossing_actors((6.0, 2.4, 2.8), 0.0, np.random.default_rng(0))["truck"].size == (6.0, 2.4, 2.8)


def test_the_mount_has_turned_fully_at_the_stop_line():
    mount = crossing_mount(EgoCameraConfig(yaw=9.0, pan=16.0))
    ground = ego_pose(-7.6)
    forward = -mount.pose(ground, EGO_ROUTE.nearest(ground.x, ground.y))[:3, 2]
    assert math.degrees(math.atan2(forward[1], forward[0])) == pytest.approx(25.0, abs=1e-3)


def test_bodies_meet_only_inside_the_conflict_zone():
    size = (6.0, 2.4, 2.8)
    states = [State(0, t, True, {"ego": ego_pose(-20.0 + 4 * t), "truck": truck_pose(20.0 - 4 * t)}) for t in range(2)]
    traffic = crossing_traffic(states, size, 1.0)
    (enter, leave), (truck_enter, truck_leave) = traffic.conflicts["truck"]
    truck_boxes = {s: box_at(TRUCK_ROUTE.pose(float(s)), size) for s in np.arange(15.0, 50.0, 0.5)}
    for s in np.arange(20.0, 55.0, 0.5):
        ego = box_at(EGO_ROUTE.pose(float(s)), EGO_SIZE)
        touching = [at for at, box in truck_boxes.items() if ego.overlaps(box)]
        assert not touching or (enter <= s <= leave and truck_enter <= min(touching) and max(touching) <= truck_leave)
    assert traffic.stop < enter
