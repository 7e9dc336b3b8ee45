"""Tubs made by hand: what is read, what is left out, and what is refused."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from aerial2ground.donkeycar import read_tub
from hashnerf.errors import UserError
from hashnerf.image_files import write_png


def write_tub(folder: Path, angles: list, deleted: tuple[int, ...] = (), size: tuple[int, int] = (6, 8)) -> Path:
    """A tub of small pictures, each of one grey, in two catalogs."""
    (folder / "images").mkdir(parents=True)
    lines = []
    for number, angle in enumerate(angles):
        write_png(folder / "images" / f"{number}_cam.png", np.full((*size, 3), number * 10, np.uint8))
        record = {"_index": number, "cam/image_array": f"{number}_cam.png", "user/angle": angle, "user/throttle": 0.5}
        lines.append(json.dumps(record))
    half = len(lines) // 2
    (folder / "catalog_0.catalog").write_text("\n".join(lines[:half]) + "\n")
    (folder / "catalog_1.catalog").write_text("\n".join(lines[half:]) + "\n")
    manifest = [["cam/image_array", "user/angle"], ["image_array", "float"], {}, {"created_at": 1.0}]
    manifest.append({"paths": ["catalog_0.catalog", "catalog_1.catalog"], "deleted_indexes": list(deleted)})
    (folder / "manifest.json").write_text("\n".join(map(json.dumps, manifest)) + "\n")
    return folder


def test_a_tub_as_told(tmp_path):
    tub = read_tub(write_tub(tmp_path / "tub", [0.0, 0.5, -1, 1.0, 0.25], deleted=(1, 4)))
    assert tub.index.tolist() == [0, 2, 3] and tub.steering.tolist() == [0.0, -1.0, 1.0]
    assert tub.pictures.shape == (3, 6, 8, 3) and tub.pictures[:, 0, 0, 0].tolist() == [0, 20, 30]
    assert tub.throttle.tolist() == [0.5, 0.5, 0.5]


def test_pictures_are_reduced_by_averaging(tmp_path):
    folder = write_tub(tmp_path / "tub", [0.0, 0.0])
    columns = np.zeros((6, 8, 3), np.uint8)
    columns[:, 1::2] = 100
    write_png(folder / "images" / "0_cam.png", columns)
    tub = read_tub(folder, 4)
    assert tub.pictures.shape == (2, 3, 4, 3) and set(tub.pictures[0].flatten().tolist()) == {50}


def edit_line(change):
    """Changes the first frame of a tub."""

    def edit(folder: Path) -> None:
        path = folder / "catalog_0.catalog"
        lines = path.read_text().splitlines()
        record = json.loads(lines[0])
        change(record)
        path.write_text("\n".join([json.dumps(record), *lines[1:]]))

    return edit


def write(name: str, text: str):
    return lambda folder: (folder / name).write_text(text)


@pytest.mark.parametrize(
    "edit, sentence",
    [
        (lambda folder: (folder / "manifest.json").unlink(), "manifest.json: does not exist; give the folder"),
        (write("manifest.json", "[1]\n{"), "manifest.json: line 2 is not JSON"),
        (write("manifest.json", "[" * 100_000), "manifest.json: line 1 is not JSON"),
        (write("manifest.json", "[1]\n"), "manifest.json: no line has the key 'paths'"),
        (write("manifest.json", '{"paths": []}'), "'paths' must be a list"),
        (write("manifest.json", '{"paths": ["catalog_9.catalog"]}'), "'catalog_9.catalog' does not exist"),
        (write("manifest.json", '{"paths": ["../x.catalog"]}'), "leaves the data folder"),
        (write("manifest.json", '{"paths": ["a"], "deleted_indexes": ["1"]}'), "'deleted_indexes' must be a list"),
        (write("catalog_0.catalog", "{}"), "catalog_0.catalog: line 1 lacks the key '_index'"),
        (write("catalog_0.catalog", "[]"), "catalog_0.catalog: line 1 is not an object"),
        (write("catalog_0.catalog", "{"), "catalog_0.catalog: line 1 is not JSON"),
        (edit_line(lambda r: r.pop("user/angle")), "line 1 lacks the key 'user/angle'"),
        (edit_line(lambda r: r.update({"user/angle": "left"})), "'user/angle' is 'left'"),
        (edit_line(lambda r: r.update({"user/angle": math.nan})), "'user/angle' is 'nan'"),
        (edit_line(lambda r: r.update({"user/throttle": 1.5})), "'user/throttle' is '1.5'"),
        (edit_line(lambda r: r.update({"_index": -1})), "'_index' is '-1'"),
        (edit_line(lambda r: r.update({"cam/image_array": "none.jpg"})), "frame 0: images: 'none.jpg' does not exist"),
        (edit_line(lambda r: r.update({"cam/image_array": 7})), "frame 0: images: the path 7 is not a file name"),
        (write("images/0_cam.png", ""), "0_cam.png is empty"),
        (
            lambda folder: write_png(folder / "images" / "1_cam.png", np.zeros((5, 8, 3), np.uint8)),
            "1_cam.png differs in size",
        ),
    ],
)
def test_a_bad_tub_is_named(tmp_path, edit, sentence):
    folder = write_tub(tmp_path / "tub", [0.0, 0.1, 0.2, 0.3])
    edit(folder)
    with pytest.raises(UserError) as caught:
        read_tub(folder)
    assert sentence in str(caught.value) and "\n" not in str(caught.value)


def test_nothing_left_and_nothing_to_enlarge(tmp_path):
    with pytest.raises(UserError, match="holds no frame that is not deleted"):
        read_tub(write_tub(tmp_path / "deleted", [0.0, 0.1], deleted=(0, 1)))
    with pytest.raises(UserError, match="8 pixels wide and width = 16"):
        read_tub(write_tub(tmp_path / "small", [0.0, 0.1]), 16)
