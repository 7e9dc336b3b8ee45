import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hashnerf.errors import UserError
from worlds.boxes import Pose
from worlds.routes import Route, conflict_interval, curve, nominal_traffic, straight


def test_straight_route_goes_on_beyond_its_ends():
    route = straight((1.0, 2.0), math.pi / 2, 10.0)
    assert route.length == pytest.approx(10)
    for s in (-3.0, 0.0, 4.0, 13.0):
        pose = route.pose(s)
        assert (pose.x, pose.y, pose.yaw) == pytest.approx((1.0, 2.0 + s, math.pi / 2))


def test_heading_turns_evenly_between_the_middles_of_segments():
    route = Route(((0.0, 0.0), (10.0, 0.0), (10.0, 10.0)))
    assert [route.pose(s).yaw for s in (2.0, 5.0, 10.0, 15.0, 18.0)] == pytest.approx(
        [0, 0, math.pi / 4, math.pi / 2, math.pi / 2]
    )


@given(st.floats(-5, 60))
def test_nearest_inverts_pose(s):
    route = Route(((0.0, 0.0), *curve((20.0, 0.0), (26.0, 0.0), (30.0, 6.0)), (40.0, 21.0)))
    pose = route.pose(s)
    assert route.nearest(pose.x, pose.y) == pytest.approx(s, abs=1e-6)


@pytest.mark.parametrize("points", [((0.0, 0.0),), ((0.0, 0.0), (1.0, 0.0), (1.0, 0.0))])
def test_points_must_differ(points):
    with pytest.raises(UserError, match="a route needs two or more points, each different from the one before"):
        Route(points)


def test_curve_starts_and_ends_along_its_control_point():
    points = curve((0.0, 0.0), (4.0, 0.0), (4.0, 4.0))
    assert points[0] == (0.0, 0.0) and points[-1] == (4.0, 4.0)
    assert points[8] == pytest.approx((3.0, 1.0))  # (P0 + 2 P1 + P2) / 4


def test_conflict_of_a_crossing_by_hand():
    # A 4 x 2 car along x meets a lane along y swept 2 m wide: they touch while |x| < 2 + 1 = 3.
    ego, other = straight((-20.0, 0.0), 0.0, 40.0), straight((0.0, 20.0), -math.pi / 2, 40.0)
    enter, leave = conflict_interval(ego, (4.0, 2.0, 1.5), other, (6.0, 2.0, 3.0))
    assert (enter, leave) == pytest.approx((17.0, 23.0), abs=0.3)
    enter, leave = conflict_interval(other, (6.0, 2.0, 3.0), ego, (4.0, 2.0, 1.5))
    assert (enter, leave) == pytest.approx((16.0, 24.0), abs=0.3)


def test_nominal_traffic_passes_through_the_states():
    routes = {"ego": straight((-20.0, 0.0), 0.0, 40.0), "van": straight((0.0, 20.0), -math.pi / 2, 40.0)}
    states = [(0, t, {"ego": Pose(-12.0 + 4 * t, 0.0, 0.0, 0.0)}) for t in range(3)]
    states += [(1, t, {**states[t][2], "van": Pose(0.0, 15.0 - 3 * t, 0.0, -math.pi / 2)}) for t in range(3)]
    traffic = nominal_traffic(routes, {"ego": (4.0, 2.0, 1.5), "van": (4.0, 2.0, 2.0)}, states, 14.0, 0.5)
    assert traffic.speeds == pytest.approx({(0, "ego"): 8.0, (1, "ego"): 8.0, (1, "van"): 6.0})
    assert (0, 0, "van") not in traffic.starts and traffic.starts[1, 2, "van"] == pytest.approx(11.0)
    assert set(traffic.conflicts) == {"van"}
