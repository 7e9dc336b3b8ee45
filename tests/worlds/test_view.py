import numpy as np
import pytest
import torch

from hashnerf.cameras import image_rays, look_at, project
from worlds.meshes import Material, block
from worlds.raycast import Caster
from worlds.rig import pinholes
from worlds.shading import Light, to_uint8
from worlds.view import LitBodies, StaticView

WHITE, BLACK = Material((0.5, 0.5, 0.5)), Material((0.0, 0.0, 0.0))
FLOOR = block((-20, -20, -0.5), (20, 20, 0.0), WHITE)
EMPTY = LitBodies(Caster([]), Light())


def camera(eye, target, up=(0, 0, 1), field_of_view=60.0, size=64):
    return pinholes([look_at(eye, target, up)], [field_of_view]).scaled(size, size)


def pixel_at(cameras, point):
    (column, row), _ = (x[0].tolist() for x in project(cameras, torch.tensor([0]), torch.tensor([point])))
    return int(row), int(column)


def test_depth_is_along_the_axis_and_unprojects_onto_the_floor():
    cameras = camera((0, -8, 5), (0, 0, 0))
    view = StaticView(LitBodies(Caster([(1, FLOOR)]), Light()), cameras, 0).with_bodies(EMPTY)
    rays = image_rays(cameras, 0)
    forward = -cameras.pose[0, :3, 2]
    depth = torch.from_numpy(view.depth).reshape(-1)
    points = rays.origins + rays.directions * (depth / (rays.directions @ forward))[:, None]
    hit = depth > 0
    assert hit.float().mean() > 0.5
    assert points[hit][:, 2].abs().max() < 1e-4
    assert (view.object_id.reshape(-1)[hit.numpy()] == 1).all() and (
        view.object_id.reshape(-1)[~hit.numpy()] == 0
    ).all()


def test_depth_looking_straight_down_is_the_height_everywhere():
    view = StaticView(LitBodies(Caster([(1, FLOOR)]), Light()), camera((0, 0, 7), (0, 0, 0), (1, 0, 0)), 0).with_bodies(
        EMPTY
    )
    np.testing.assert_allclose(view.depth, 7.0, rtol=1e-5)


@pytest.mark.parametrize("moving", [False, True])
def test_shadow_falls_away_from_the_sun_with_the_right_length(moving):
    # Sun in +x at 45 degrees, a box 2 m high whose far side is at x = -1: its shadow covers x from -3 to -1.
    cube = block((-1, -1, 0), (1, 1, 2), WHITE)
    static = [(1, FLOOR)] if moving else [(1, FLOOR), (2, cube)]
    cameras = camera((0, 0, 30), (0, 0, 0), (0, 1, 0), 20.0, 128)
    stage_light = Light(azimuth=0.0, elevation=45.0)
    stage = LitBodies(Caster(static), stage_light)
    rgb = (
        StaticView(stage, cameras, 0)
        .with_bodies(LitBodies(Caster([(2, cube)]), stage_light) if moving else EMPTY)
        .rgb.astype(int)
    )
    lit, shadow = rgb[pixel_at(cameras, (3.0, 3.0, 0.0))], rgb[pixel_at(cameras, (-2.0, 0.0, 0.0))]
    assert shadow.sum() < 0.8 * lit.sum()
    for dark, x, y in [(True, -2.8, 0.0), (False, -3.2, 0.0), (True, -1.3, 0.8), (False, -1.5, 1.2), (False, 1.3, 0.0)]:
        np.testing.assert_array_equal(rgb[pixel_at(cameras, (x, y, 0.0))], shadow if dark else lit)


def test_a_moving_body_gives_the_same_picture_as_a_static_one():
    cube, cameras = block((-1, -1, 0), (1, 1, 2), WHITE), camera((5, -8, 5), (0, 0, 0))
    still = StaticView(LitBodies(Caster([(1, FLOOR), (2, cube)]), Light()), cameras, 0).with_bodies(EMPTY)
    moved = StaticView(LitBodies(Caster([(1, FLOOR)]), Light()), cameras, 0).with_bodies(
        LitBodies(Caster([(2, cube)]), Light())
    )
    np.testing.assert_array_equal(still.rgb, moved.rgb)
    np.testing.assert_array_equal(still.depth, moved.depth)
    np.testing.assert_array_equal(still.object_id, moved.object_id)


def test_an_edge_through_a_pixel_is_the_mean_of_both_sides():
    # 8 px over 8 m seen from above: 1 m a pixel at z = 0. The black half starts in the middle of column 4 (x = 0.5 m).
    angle = float(np.rad2deg(2 * np.arctan(4 / 100)))
    cameras = camera((0, 0, 100), (0, 0, 0), (0, 1, 0), angle, 8)
    halves = [(1, block((-20, -20, -0.5), (0.5, 20, 0), WHITE)), (2, block((0.5, -20, -0.5), (20, 20, 0), BLACK))]
    stage = LitBodies(Caster(halves), Light(elevation=90.0))
    row = StaticView(stage, cameras, 0).with_bodies(EMPTY).rgb[4]
    white = np.flatnonzero(stage.caster.normal[:, 2] > 0.9)[0]
    linear = stage.face_light.sun[white] + stage.face_light.ambient[white]
    np.testing.assert_array_equal(row[3], to_uint8(linear))
    np.testing.assert_array_equal(row[4], to_uint8(0.5 * linear))
    np.testing.assert_array_equal(row[5], [0, 0, 0])


def test_unoccluded_pixels_and_object_ids_by_hand():
    # The target is 2 m wide at 10 m, the focal length is 32 / tan 30 = 55.4 px: 11.1 px across, 11 x 11 pixel centres.
    target = Caster([(5, block((10, -1, -1), (11, 1, 1), WHITE))])
    cameras = camera((0, 0, 0), (1, 0, 0))

    def visible(*walls):
        view = StaticView(LitBodies(Caster([(1, FLOOR.placed(0, 0, -3, 0)), *walls]), Light()), cameras, 0)
        return int((view.with_bodies(LitBodies(target, Light())).object_id == 5).sum()), view.pixels_of(target)

    seen, alone = visible()
    assert seen == alone and abs(alone - 11.1**2) < 23
    assert visible((2, block((5, -3, -3), (5.2, 3, 3), WHITE))) == (0, alone)
    # A wall over its left half: y > 0 hides half of the columns.
    half, _ = visible((2, block((5, 0, -3), (5.2, 3, 3), WHITE)))
    assert half / alone == pytest.approx(0.5, abs=0.06)
