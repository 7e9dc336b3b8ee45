"""Strict reading, atomic writing, and the sentences about the optional keys."""

import json
import math
import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hashnerf import transforms_json
from hashnerf.errors import UserError
from hashnerf.posed_images import FRAME_KEYS
from hashnerf.transforms_json import check_extras, misspelled, read_transforms, write_atomically, write_transforms

VIEWS = [(0, 0, 0), (0, 0, 1), (1, 0, 0)]
BOX = {"branch": 1, "step": 0, "center": [1, 2.5, 0], "size": [4, 2, 1.5], "yaw": 0.1}


BROKEN = [
    (b'{"frames": [NaN]}', "the token NaN in line 1 is not JSON"),
    (b'{"name": "NaN",\n "w": 1,\n "h":\n NaN}', "the token NaN in line 4 is not JSON"),
    (b'{"note": "x, NaN", \n"h": NaN}', "the token NaN in line 2 is not JSON"),
    (b'{"w": -Infinity}', "the token -Infinity in line 1 is not JSON"),
    (b'{"w": 1e999}', "1e999 is too large"),
    (b'{"w": ' + b"9" * 5000 + b"}", "is not strict JSON"),
    (b'{"w": 1, "h": 2, "w": 3}', "the key 'w' appears twice"),
    (b'{"frames": [{"a": 1, "a": 1}]}', "the key 'a' appears twice"),
    (b"[" * 100_000 + b"]" * 100_000, "nested too deeply"),
    (b'{"a":' * 60 + b"1" + b"}" * 60, "nested too deeply"),
    (b'{"frames": [', "is not strict JSON"),
    (b"", "is not strict JSON"),
    (b"[]", "the top level is a list"),
    (b'{"name": "\xff"}', "is not UTF-8 text (byte 10)"),
]


def test_k34_a_broken_file_is_named(tmp_path, numeric_row):
    path, wrong = tmp_path / "transforms.json", []
    for text, sentence in BROKEN:
        path.write_bytes(text)
        try:
            read_transforms(path)
            wrong.append(text[:40])
        except UserError as error:
            wrong += [] if sentence in str(error) and str(path) in str(error) else [(text[:40], str(error))]
    print(wrong)
    numeric_row("K34", f"{len(BROKEN)} texts: NaN, twice a key, 1e5 levels, ...: read, or not named", len(wrong))


def test_k34_a_huge_file_is_refused_before_it_is_read(tmp_path, monkeypatch, numeric_row):
    path, read = tmp_path / "transforms.json", []
    for size in (201 * 2**20, 2**30):
        with path.open("wb") as file:
            file.truncate(size)  # sparse: takes no disk
        with (
            monkeypatch.context() as patch,
            pytest.raises(UserError, match=f"{size >> 20} MB is over the limit of 200"),
        ):
            patch.setattr(type(path), "read_bytes", lambda self: read.append(self) or b"")
            read_transforms(path)
    numeric_row("K34", "files of 201 MB and 1 GB: read", len(read))


@pytest.mark.parametrize("kind", ["missing", "folder", "fifo"])
def test_what_is_not_a_file_is_refused_without_hanging(tmp_path, kind):
    path = tmp_path / "transforms.json"
    if kind == "folder":
        path.mkdir()
    if kind == "fifo":
        os.mkfifo(path)
    with pytest.raises(UserError, match="not found or not a regular file"):
        read_transforms(path)


def test_a_byte_order_mark_is_accepted(tmp_path):
    (tmp_path / "transforms.json").write_bytes(b'\xef\xbb\xbf{"w": 1}')
    assert read_transforms(tmp_path / "transforms.json") == {"w": 1}


JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**53), 2**53)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda children: st.lists(children, max_size=4) | st.dictionaries(st.text(), children, max_size=4),
    max_leaves=20,
)


@settings(deadline=None, max_examples=60)
@given(document=st.dictionaries(st.text(), JSON, max_size=5))
def test_what_is_written_is_read_back(tmp_path_factory, document):
    path = tmp_path_factory.mktemp("json") / "transforms.json"
    try:
        json.dumps(document, ensure_ascii=False).encode("utf-8")
    except UnicodeEncodeError:
        return  # lone surrogates are no text
    write_transforms(path, document)
    assert read_transforms(path) == document


@pytest.mark.parametrize("value", [math.nan, math.inf, {1, 2}, b"bytes"])
def test_what_is_not_json_is_not_written(tmp_path, value):
    path = tmp_path / "transforms.json"
    write_transforms(path, {"w": 1})
    with pytest.raises(UserError, match="cannot be written as strict JSON"):
        write_transforms(path, {"w": value})
    assert read_transforms(path) == {"w": 1}
    assert os.listdir(tmp_path) == ["transforms.json"]


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_a_crash_while_writing_leaves_the_old_file(tmp_path, monkeypatch, step):
    path = tmp_path / "transforms.json"
    write_transforms(path, {"w": 1})

    def full_disk(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(transforms_json.os, step, full_disk)
    with pytest.raises(UserError, match=r"transforms.json: cannot be written \(No space left"):
        write_transforms(path, {"w": 2})
    assert read_transforms(path) == {"w": 1} and os.listdir(tmp_path) == ["transforms.json"]


def test_files_get_the_usual_permissions_and_folders_are_made(tmp_path):
    write_atomically(tmp_path / "new" / "file.bin", b"data")
    (tmp_path / "plain.bin").write_bytes(b"data")
    assert (tmp_path / "new" / "file.bin").read_bytes() == b"data"
    assert (tmp_path / "new" / "file.bin").stat().st_mode == (tmp_path / "plain.bin").stat().st_mode


def test_a_complete_set_of_extras_has_no_problems():
    document = {
        "scene_box": [[-1, -1, 0], [1, 1, 2.5]],
        "camera_kinds": ["ego", "elevated"],
        "branches": ["absent", "present"],
        "states": [{"branch": 0, "step": 0, "hazard": False}, {"branch": 1, "step": 0}],
        "actors": {"truck": [BOX], "ego": []},
        "visibility": {"truck": [[1, 0, 0, 12, 40]]},
    }
    assert check_extras(document, VIEWS) == [] and check_extras({}, VIEWS) == []


def test_keys_of_other_tools_are_left_alone():
    frame = {"depth_file_path": "x", "mask_path": "y", "colmap_im_id": 3, "sharpness": 1.0}
    assert misspelled(frame, FRAME_KEYS) == []
    assert misspelled({"Split": "test"}, FRAME_KEYS) == ["the key 'Split' is unknown; did you mean 'split'?"]
    for slip, meant in (("spilt", "split"), ("setp", "step"), ("barnch", "branch"), ("camrea", "camera")):
        assert misspelled({slip: 0}, FRAME_KEYS) == [f"the key {slip!r} is unknown; did you mean {meant!r}?"]
    assert misspelled({"brnch": 1, "splits": "train"}, FRAME_KEYS) == [
        "the key 'brnch' is unknown; did you mean 'branch'?",
        "the key 'splits' is unknown; did you mean 'split'?",
    ]


@pytest.mark.parametrize(
    "document, sentence",
    [
        ({"scene_box": [[0, 0, 0], [1, 1]]}, "scene_box must be"),
        ({"scene_box": [[0, 0, 0], [1, 1, math.nan]]}, "scene_box must be"),
        ({"scene_box": [[0, 0, 0], [1, 0, 1]]}, "every lower corner coordinate must be below"),
        ({"states": {}}, "states must be a list"),
        ({"states": [3]}, "states[0] must be an object with the keys branch, step, hazard"),
        ({"states": [{"branch": 0}]}, "states[0] lacks the key 'step'"),
        ({"states": [{"branch": 0, "step": -1}]}, "states[0] has step = -1"),
        ({"states": [{"branch": 0, "step": True}]}, "states[0] has step = True"),
        ({"states": [{"branch": 0, "step": 0, "hazard": "no"}]}, "states[0] has hazard = no"),
        ({"states": [{"branch": 0, "step": 0, "hazzard": True}]}, "unknown key 'hazzard'"),
        ({"states": [{"branch": 0, "step": 0}] * 2}, "states[1]: branch 0 step 0 is listed twice"),
        ({"states": [{"branch": 0, "step": 7}]}, "states[0]: branch 0 step 7 has no frame"),
        ({"states": [{"branch": 0, "step": 0}]}, "states does not list branch 1 step 0"),
        ({"branches": "ab"}, "branches must be a list of names"),
        ({"branch_weights": [1.0]}, "branch_weights has 1 numbers but the frames use the branches 0 to 1"),
        ({"branch_weights": [1.0, 0.0]}, "branch_weights must be a list of positive numbers"),
        ({"branch_weights": [1.0, "2"]}, "branch_weights must be a list of positive numbers"),
        ({"branches": ["only"]}, "branches has 1 names but the frames use the indices 0 to 1"),
        ({"camera_kinds": ["ego", 3]}, "camera_kinds must be a list of names"),
        ({"camera_kinds": []}, "camera_kinds has 0 names"),
        ({"actors": []}, "actors must be an object"),
        ({"actors": {"truck": {}}}, "actors.truck must be a list"),
        ({"actors": {"truck": [None]}}, "actors.truck[0] must be an object"),
        ({"actors": {"truck": [{**BOX, "size": [4, 0, 1]}]}}, "actors.truck[0] has size = [4, 0, 1]"),
        ({"actors": {"truck": [{**BOX, "center": [1, 2]}]}}, "actors.truck[0] has center = [1, 2]"),
        ({"actors": {"truck": [{**BOX, "yaw": math.inf}]}}, "actors.truck[0] has yaw = inf"),
        ({"actors": {"truck": [BOX, {**BOX, "step": 5}]}}, "actors.truck[1] is at branch 1 step 5, a state that no"),
        ({"actors": {"truck": [BOX, BOX]}}, "actors.truck[1] repeats branch 1 step 0"),
        ({"visibility": 3}, "visibility must be an object"),
        ({"visibility": {"truck": 3}}, "visibility.truck must be a list"),
        ({"visibility": {"truck": [[0, 0, 0, 1]]}}, "visibility.truck[0] must be [branch, step, camera"),
        ({"visibility": {"truck": [[0, 0, 0, 1.5, 2]]}}, "visibility.truck[0] must be [branch, step, camera"),
        ({"visibility": {"truck": [[0, 0, 9, 1, 2]]}}, "names branch 0 step 0 camera 9, which no frame shows"),
        ({"visibility": {"truck": [[0, 0, 1, 3, 2]]}}, "visibility.truck[0] has 3 visible pixels but only 2"),
        ({"world": "intersection"}, "world must be an object"),
    ],
)
def test_a_bad_extra_is_named(document, sentence):
    problems = check_extras(document, VIEWS)
    assert len(problems) == 1 or "states" in document
    assert any(sentence in problem for problem in problems), problems
