import numpy as np
import pytest
import trimesh

from hashnerf.errors import UserError
from worlds.glb import Z_UP_TO_Y_UP, export_glb
from worlds.intersection import IntersectionConfig
from worlds.scenarios import build_world
from worlds.scene import Scene

WORLD = build_world(IntersectionConfig(), 0)
SCENE = Scene(WORLD, WORLD.states[5].poses)


def test_a_scene_opens_again_with_names_places_and_colours(tmp_path):
    path = tmp_path / "new" / "scene.glb"
    export_glb(SCENE, path)
    opened = trimesh.load_scene(path)
    names = {name for name, _ in WORLD.static} | {"ego", "truck"}
    assert names <= set(opened.graph.nodes)
    back = np.linalg.inv(Z_UP_TO_Y_UP)
    corners, colours = [], []
    for node in opened.graph.nodes_geometry:
        if node.startswith("truck."):
            matrix, geometry = opened.graph[node]
            mesh = opened.geometry[geometry]
            corners.append(trimesh.transform_points(mesh.vertices, back @ matrix))
            colours.append(tuple(mesh.visual.material.baseColorFactor[:3]))
    corners = np.concatenate(corners)
    np.testing.assert_allclose([corners.min(0), corners.max(0)], SCENE.mesh("truck").bounds, atol=1e-4)
    paint = np.rint(255 * np.array([0.75, 0.13, 0.03])).astype(int).tolist()
    assert paint in [list(map(int, colour)) for colour in colours]


def test_glb_up_is_y():
    np.testing.assert_array_equal(Z_UP_TO_Y_UP[:3, :3] @ [0, 0, 1], [0, 1, 0])
    assert np.linalg.det(Z_UP_TO_Y_UP) == pytest.approx(1)


def test_a_place_that_cannot_be_written_is_one_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match=r"cannot be written .*; choose another --glb file"):
        export_glb(SCENE, tmp_path / "file" / "scene.glb")
