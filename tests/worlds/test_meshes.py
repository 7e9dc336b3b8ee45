import numpy as np
import pytest
import trimesh

from worlds.meshes import Material, blob, block, cylinder, hexahedron, merge, quad, tapered

GREY = Material((0.5, 0.5, 0.5), grain=0.1, gloss=0.2)


def volume(mesh) -> float:
    """Signed volume: positive only when faces are counter-clockwise seen from outside."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces].astype(np.float64), 1, 0)
    return float((a * np.cross(b, c)).sum() / 6)


def test_block_is_closed_and_faces_outwards():
    mesh = block((1, 2, 3), (3, 5, 7), GREY)
    assert volume(mesh) == pytest.approx(2 * 3 * 4)
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).is_watertight
    np.testing.assert_array_equal(mesh.bounds, [[1, 2, 3], [3, 5, 7]])


def test_tapered_volume_is_a_frustum():
    # 4 x 2 below, 2 x 1 above, height 3: h/6 (A0 + A1 + (4 + 2)(2 + 1)) = 3/6 (8 + 2 + 18).
    mesh = tapered((-2, 2), (-1, 1), (1.0, 0.5), (0, 3), GREY)
    assert volume(mesh) == pytest.approx(14.0)


def test_cylinder_along_y_faces_outwards_and_is_centred():
    mesh = cylinder((1, 2, 3), radius=0.5, height=2.0, material=GREY, axis="y", sides=64)
    assert volume(mesh) == pytest.approx(np.pi * 0.25 * 2, rel=0.01)
    np.testing.assert_allclose(mesh.bounds, [[0.5, 1, 2.5], [1.5, 3, 3.5]], atol=1e-3)


def test_blob_faces_outwards():
    assert volume(blob((0, 0, 0), (1, 1, 1), GREY, np.random.default_rng(0))) > 3


def test_quad_faces_the_side_from_which_its_corners_turn_left():
    mesh = quad([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], GREY)
    a, b, c = mesh.vertices[mesh.faces[0]]
    assert np.cross(b - a, c - a)[2] == pytest.approx(1)


def test_placed_turns_before_it_moves():
    mesh = block((0, 0, 0), (2, 1, 1), GREY).placed(10, 20, 0.5, np.pi / 2)
    # x in [0, 2] becomes y in [20, 22], y in [0, 1] becomes x in [9, 10].
    np.testing.assert_allclose(mesh.bounds, [[9, 20, 0.5], [10, 22, 1.5]], atol=1e-6)


def test_merge_keeps_faces_with_their_vertices_and_materials():
    red = Material((1.0, 0.0, 0.0))
    bottom, top = ([(x, y, z) for x, y in ((5, 0), (6, 0), (6, 1), (5, 1))] for z in (0, 1))
    both = merge([block((0, 0, 0), (1, 1, 1), GREY), hexahedron(bottom, top, red)])
    assert volume(both) == pytest.approx(2)
    far = both.vertices[both.faces].mean(1)[:, 0] > 3
    np.testing.assert_array_equal(both.colour[far], np.tile([1, 0, 0], (12, 1)))
    np.testing.assert_array_equal(both.gloss[~far], np.full(12, 0.2, np.float32))
