import numpy as np

from worlds.scenarios import build_world
from worlds.single_scene_intersection import SingleSceneIntersectionConfig

WORLD = build_world(SingleSceneIntersectionConfig(), 0)


def test_ten_even_steps_past_a_waiting_ego():
    assert [(s.branch, s.step) for s in WORLD.states] == [(0, step) for step in range(10)]
    y = [s.poses["truck"].y for s in WORLD.states]
    np.testing.assert_allclose(np.diff(y), -4.5)
    assert len({s.poses["ego"] for s in WORLD.states}) == 1


def test_hazard_from_two_steps_before_the_conflict_zone_until_it_is_left():
    enter, leave = WORLD.traffic.conflicts["truck"][1]
    s = [WORLD.traffic.starts[0, step, "truck"] for step in range(10)]
    assert [state.hazard for state in WORLD.states] == [enter - 9.0 <= place <= leave for place in s]
    assert 2 <= sum(state.hazard for state in WORLD.states) <= 5 and not WORLD.states[0].hazard
    assert not WORLD.states[-1].hazard
