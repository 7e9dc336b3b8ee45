import numpy as np
import pytest

from worlds.meshes import merge
from worlds.raycast import Caster
from worlds.street import DOOR, FRAME, PAINT, ROOF, building, dashes, ground, hedge, slab, tree, zebra
from worlds.vehicles import GLASS


def colour_at(mesh, origin, direction):
    caster = Caster([(1, mesh)])
    _, face = caster.cast(np.array([origin], np.float32), np.array([direction], np.float32))
    return tuple(caster.mesh.colour[face[0]].tolist())


def like(material):
    return pytest.approx(material.colour)


def test_ground_is_flat_at_zero_and_a_slab_rises_above_it():
    assert ground((-5.0, -4.0, 5.0, 4.0)).bounds[1].tolist() == [5, 4, 0]
    assert slab((0.0, 0.0, 1.0, 1.0), 0.12, PAINT).bounds[1][2] == pytest.approx(0.12)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_dashes_keep_length_and_gap(axis):
    # From 0 to 10 with 2 m dashes and 1 m gaps: 0-2, 3-5, 6-8.
    parts = dashes(0.0, 10.0, 1.5, axis, 2.0, 1.0)
    along, across = (0, 1) if axis == "x" else (1, 0)
    assert [(part.bounds[0][along], part.bounds[1][along]) for part in parts] == [(0, 2), (3, 5), (6, 8)]
    for part in parts:
        assert part.bounds[:, across].tolist() == pytest.approx([1.43, 1.57])


def test_zebra_stripes_lie_inside_and_face_up():
    mesh = merge(zebra((0.0, 0.0, 3.0, 5.0), "y"))
    low, high = mesh.bounds
    assert (low[:2] >= 0).all() and high[0] <= 3 and high[1] <= 5
    painted = [
        colour_at(merge([ground((0.0, 0.0, 3.0, 5.0)), mesh]), (1.5, y, 2.0), (0, 0, -1)) for y in (0.4, 0.9, 1.3)
    ]
    assert painted[0] == like(PAINT) and painted[1] != like(PAINT) and painted[2] == like(PAINT)


def test_a_building_shows_windows_and_a_door_on_every_side():
    mesh = building((0.0, 0.0, 8.0, 8.0), 6.2, (0.5, 0.3, 0.2))
    # 8 m walls: (8 - 0.8) // 2.4 = 3 columns 2.4 m apart, the door below in the middle one, windows on two floors.
    for origin, direction, side in [((0, -9, 0), (0, 1, 0), 0), ((9, 0, 0), (-1, 0, 0), 1), ((-9, 0, 0), (1, 0, 0), 1)]:
        for middle, height, material in [(4.0, 1.0, DOOR), (1.6, 1.6, GLASS), (4.0, 4.6, GLASS), (6.4, 4.6, GLASS)]:
            start = [*origin[:2], height]
            start[side] = middle
            assert colour_at(mesh, start, direction) == like(material)
    assert colour_at(mesh, (4, -9, 3.4), (0, 1, 0)) == like(type(DOOR)((0.5, 0.3, 0.2)))
    assert colour_at(mesh, (4, -9, 6.05), (0, 1, 0)) == like(FRAME)
    assert colour_at(mesh, (4, 4, 9), (0, 0, -1)) == like(ROOF)


def test_plants_stand_on_the_ground():
    assert hedge((0.0, 0.0, 4.0, 1.0), 1.7).bounds.tolist() == [[0, 0, 0], [4, 1, pytest.approx(1.7)]]
    bounds = tree(3.0, 4.0, 5.0, np.random.default_rng(0)).bounds
    assert bounds[0][2] == pytest.approx(0) and 4.0 < bounds[1][2] < 6.5
    assert np.abs(bounds[:, 0] - 3).max() < 3
