import pytest

from hashnerf.errors import UserError
from worlds.cube_cylinder import CubeCylinderConfig
from worlds.scenarios import build_world
from worlds.scene import Scene

WORLD = build_world(CubeCylinderConfig(jitter=0.0), 0)


def test_left_and_right_share_their_first_state_and_then_part():
    places = {(s.branch, s.step): s.poses.get("cylinder") for s in WORLD.states}
    assert places[0, 0] is None and places[0, 1] is None
    assert places[1, 0] == places[2, 0]
    assert (places[1, 0].x, places[1, 1].x, places[2, 1].x) == pytest.approx((0.0, -2.2, 2.2))
    assert places[1, 0].y == places[1, 1].y == places[2, 1].y


def test_the_cylinder_is_there_and_goes_left_with_equal_chance():
    chance = dict(zip(WORLD.branches, WORLD.branch_weights))
    assert chance["absent"] == chance["left"] + chance["right"]
    assert chance["left"] == chance["right"]


def test_the_cube_hides_the_cylinder_from_the_middle_of_the_ring_only():
    def pixels(index):
        ids = Scene(WORLD, WORLD.states[2].poses).render(WORLD.rig.cameras, index).object_id
        return int((ids == WORLD.object_id("cylinder")).sum())

    assert pixels(28) == 0
    assert pixels(2) > 100 and pixels(53) > 100


def test_a_move_out_of_range_is_refused():
    with pytest.raises(UserError, match=r"move = 9.0 is out of range; give a number from 1.5 to 4.0"):
        CubeCylinderConfig(move=9.0)
