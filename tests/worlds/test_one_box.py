"""A box in the air, or nothing: both can be rendered from all sides."""

import pytest

from hashnerf.errors import UserError
from worlds.one_box import OneBoxConfig
from worlds.scenarios import build_world
from worlds.scene import Scene


def test_every_camera_sees_the_box_as_large_as_it_is():
    world = build_world(OneBoxConfig(), 0)
    for index in (0, 21, 50):
        view = Scene(world, {}).render(world.rig.cameras, index)
        distance = float(world.rig.cameras.pose[index, :3, 3].norm())
        # the focal length is 64 / tan(25 degrees), 137 pixels; a cube's outline is between its face and sqrt(3) of it
        face = (137.2 / distance) ** 2
        assert 0.8 * face < (view.object_id == 1).sum() < 2.5 * face
        assert distance - 0.9 < view.depth[view.object_id == 1].min() < distance


def test_an_empty_sky_has_neither_depth_nor_bodies():
    world = build_world(OneBoxConfig(boxes=0), 0)
    view = Scene(world, {}).render(world.rig.cameras, 3)
    assert not view.object_id.any() and not view.depth.any()
    assert view.rgb.std(axis=(0, 1)).max() < 40 and view.rgb.min() > 50


def test_held_out_cameras_are_among_the_others():
    splits = build_world(OneBoxConfig(), 0).rig.splits
    assert splits.count("test") == 8 and splits[0] == splits[-1] == "train"


def test_two_boxes_are_refused():
    with pytest.raises(UserError, match="boxes = 2 is out of range"):
        OneBoxConfig(boxes=2)
