import numpy as np
import pytest

from hashnerf.errors import UserError
from worlds.intersection import IntersectionConfig
from worlds.scenarios import build_world
from worlds.scene import Scene
from worlds.view import StaticView

WORLD = build_world(IntersectionConfig(), 0)
SIZE = 64
CAMERAS = WORLD.rig.cameras.scaled(SIZE, SIZE)
SCENES = [Scene(WORLD, state.poses) for state in WORLD.states]


def pictures(index):
    static = StaticView(WORLD.stage, CAMERAS, index)
    return [static.with_bodies(scene.bodies) for scene in SCENES]


def truck_pixels(index, step):
    return int((pictures(index)[3 + step].object_id == WORLD.object_id("truck")).sum())


def test_two_branches_of_three_steps():
    assert WORLD.branches == ("absent", "present")
    assert [(s.branch, s.step, s.hazard) for s in WORLD.states] == [
        (branch, step, branch == 1) for branch in (0, 1) for step in range(3)
    ]
    assert [("truck" in s.poses) for s in WORLD.states] == [False] * 3 + [True] * 3
    assert [s.poses["ego"].x for s in WORLD.states] == [-27.0, -19.0, -11.0] * 2


def test_every_state_differs_from_above():
    seen = {view.rgb.tobytes() for view in pictures(99)}
    assert len(seen) == 6


def test_a_camera_ahead_of_the_ego_does_not_see_it_and_one_behind_does():
    x = WORLD.rig.cameras.pose[:, 0, 3].numpy()
    between = int(np.flatnonzero((np.array(WORLD.rig.kinds) == "ego") & (x > -16.0) & (x < -14.0))[2])
    seen = [int((view.object_id == WORLD.object_id("ego")).sum()) for view in pictures(between)[:3]]
    assert seen[0] == seen[1] == 0 and seen[2] > 0.02 * SIZE**2


def test_the_junction_opens_up_along_the_approach():
    x = WORLD.rig.cameras.pose[:56, 0, 3].numpy()
    back, front = np.flatnonzero(x < -26)[::4], np.flatnonzero(x > -15.5)[::4]
    assert all(truck_pixels(int(i), 1) == 0 for i in back)
    assert sum(truck_pixels(int(i), 2) > 2 for i in back) == 0
    assert all(truck_pixels(int(i), 2) > 60 for i in front)


def test_the_nominal_run_passes_through_the_states():
    traffic = WORLD.traffic
    assert traffic.speeds == pytest.approx({(0, "ego"): 8.0, (1, "ego"): 8.0, (1, "truck"): 7.4})
    for state in WORLD.states:
        for name, pose in state.poses.items():
            at = traffic.routes[name].pose(traffic.starts[state.branch, state.step, name])
            assert (at.x, at.y, at.yaw) == pytest.approx((pose.x, pose.y, pose.yaw))
    # The front at the stop line: 2.25 m behind it.
    assert traffic.routes["ego"].pose(traffic.stop).x == pytest.approx(-7.6 - 2.25)
    (enter, _), (truck_enter, truck_leave) = traffic.conflicts["truck"]
    assert traffic.stop < enter
    assert traffic.starts[1, 2, "truck"] < truck_enter < truck_leave


@pytest.mark.parametrize(
    ("key", "value"),
    [("ego_step", 5.0), ("truck_step", 3.0), ("jitter", 2.0), ("ego_start", float("nan")), ("step_seconds", 0.0)],
)
def test_settings_out_of_range_are_refused(key, value):
    with pytest.raises(UserError, match=rf"^{key} = {value} is out of range; give a number from .* to .*\.$"):
        IntersectionConfig(**{key: value})
