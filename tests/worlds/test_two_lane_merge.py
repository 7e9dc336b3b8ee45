import numpy as np
import pytest

from worlds.boxes import box_at
from worlds.scenarios import build_world
from worlds.scene import Scene
from worlds.two_lane_merge import TwoLaneMergeConfig
from worlds.view import StaticView

WORLD = build_world(TwoLaneMergeConfig(), 0)


def test_both_branches_share_their_first_state():
    fast, slow = WORLD.states[0], WORLD.states[3]
    assert (fast.step, slow.step) == (0, 0) and fast.poses == slow.poses
    assert fast.hazard and not slow.hazard
    cameras = WORLD.rig.cameras.scaled(64, 64)
    for index in (0, 30, 55, 80, 99):
        static = StaticView(WORLD.stage, cameras, index)
        one, two = (static.with_bodies(Scene(WORLD, state.poses).bodies).rgb for state in (fast, slow))
        np.testing.assert_array_equal(one, two)


def test_later_states_differ_from_above():
    static = StaticView(WORLD.stage, WORLD.rig.cameras, 99)
    seen = [static.with_bodies(Scene(WORLD, state.poses).bodies).rgb.tobytes() for state in WORLD.states]
    assert len(set(seen)) == 5


@pytest.mark.parametrize(("branch", "collides"), [(0, True), (1, False)])
def test_going_on_at_nominal_speed_is_unsafe_only_in_the_fast_branch(branch, collides):
    traffic = WORLD.traffic
    touched = False
    for seconds in np.arange(0.0, 6.0, 0.05):
        boxes = {}
        for name, actor in WORLD.actors.items():
            s = traffic.starts[branch, 0, name] + traffic.speeds[branch, name] * seconds
            boxes[name] = box_at(traffic.routes[name].pose(float(s)), actor.size)
        touched |= any(boxes["ego"].overlaps(boxes[name]) for name in ("lead", "second"))
    assert touched == collides


def test_the_ego_drives_onto_the_near_lane():
    route = WORLD.traffic.routes["ego"]
    end = route.pose(route.length)
    assert (end.y, end.yaw) == pytest.approx((0.0, 0.0))
    assert route.pose(0.0).yaw == pytest.approx(np.deg2rad(65))
