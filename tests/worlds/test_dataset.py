import hashlib

import cv2
import numpy as np
import pytest

from hashnerf.posed_images import load_posed_images
from hashnerf.transforms_json import read_transforms
from worlds.cube_cylinder import CubeCylinderConfig
from worlds.dataset import write_dataset
from worlds.intersection import IntersectionConfig


def digests(folder):
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    folder = tmp_path_factory.mktemp("small")
    return folder, write_dataset(IntersectionConfig(), 0, folder, 16, 1)


def test_files_do_not_depend_on_the_number_of_workers(tmp_path):
    for name, workers in (("one", 1), ("two", 2)):
        (tmp_path / name).mkdir()
        write_dataset(CubeCylinderConfig(), 5, tmp_path / name, 8, workers)
    one, two = digests(tmp_path / "one"), digests(tmp_path / "two")
    assert len(one) == 2 * 600 + 1
    assert one == two


def test_the_loader_accepts_it(small):
    folder, document = small
    loaded = load_posed_images(folder)
    assert len(loaded) == 600 and loaded.images.shape == (600, 16, 16, 3)
    assert len(loaded.split("test")) == 6 * 12
    np.testing.assert_allclose(loaded.scene_box.numpy(), np.array(document["scene_box"]), rtol=1e-6)
    frame = loaded.frames[417]
    assert frame.file_path == f"images/b{frame.branch}_s{frame.step}_c{frame.camera:03d}.png"


def test_k46_no_picture_is_in_two_splits(small, numeric_row):
    folder, document = small
    digests = {"train": set(), "test": set()}
    for frame in document["frames"]:
        digests[frame["split"]].add(hashlib.sha256((folder / frame["file_path"]).read_bytes()).hexdigest())
    assert len(digests["test"]) > 20
    numeric_row("K46", "600 pictures of a crossing: in both splits", len(digests["train"] & digests["test"]))


def test_the_document_is_what_is_on_disk(small):
    folder, document = small
    assert read_transforms(folder / "transforms.json") == document
    assert [(s["branch"], s["step"], s["hazard"]) for s in document["states"]] == [
        (branch, step, branch == 1) for branch in (0, 1) for step in range(3)
    ]
    assert document["branches"] == ["absent", "present"]
    assert document["camera_kinds"].count("ego") == 56


def test_actors_are_listed_only_where_they_are_present(small):
    _, document = small
    assert [(a["branch"], a["step"]) for a in document["actors"]["truck"]] == [(1, 0), (1, 1), (1, 2)]
    assert len(document["actors"]["ego"]) == 6
    truck = document["actors"]["truck"][2]
    length, width, height = truck["size"]
    assert length > width and height == pytest.approx(2 * truck["center"][2])
    assert truck["yaw"] == pytest.approx(-np.pi / 2)


def test_visibility_has_every_state_and_camera_with_the_actor(small):
    _, document = small
    rows = document["visibility"]["truck"]
    assert [row[:3] for row in rows] == [[1, step, camera] for step in range(3) for camera in range(100)]
    assert len(document["visibility"]["ego"]) == 600
    assert all(0 <= seen <= alone <= 256 for *_, seen, alone in rows)


def test_where_the_truck_is_visible_the_branches_differ(small):
    folder, document = small
    for branch, step, camera, seen, _ in document["visibility"]["truck"]:
        if seen > 2:  # one pixel centre may hit a sliver that all four colour samples miss
            one, two = (cv2.imread(str(folder / f"images/b{b}_s{step}_c{camera:03d}.png")) for b in (0, branch))
            assert (one != two).any()


def test_depth_is_sixteen_bit_millimetres(small):
    folder, document = small
    depth = cv2.imread(str(folder / "depth/b0_s0_c099.png"), cv2.IMREAD_UNCHANGED)
    assert depth.dtype == np.uint16
    height = next(f for f in document["frames"] if f["camera"] == 99)["transform_matrix"][2][3]
    # Straight down from above: the ground at z = 0 is the farthest, at the camera's height.
    assert depth.max() == pytest.approx(1000 * height, abs=1)
