"""What a folder was made from: continued for the same, refused for something else, emptied only when asked to."""

import pytest

from hashnerf.errors import UserError
from hashnerf.made_from import MADE_FROM, begin, digest


def test_a_folder_is_continued_for_the_same(tmp_path):
    folder = tmp_path / "views"
    begin(folder, {"seed": 1, "camera": {"width": 4, "tilt": (1, 2)}})
    (folder / "0.png").write_bytes(b"x")
    begin(folder, {"seed": 1, "camera": {"width": 4, "tilt": (1, 2)}})
    assert (folder / "0.png").read_bytes() == b"x"


def test_something_else_is_named_and_nothing_is_touched(tmp_path):
    begin(tmp_path, {"seed": 1, "camera": {"width": 4}})
    (tmp_path / "0.png").write_bytes(b"x")
    with pytest.raises(UserError, match=r"camera.width: 4 -> 5\); choose another run name, or .*--overwrite true"):
        begin(tmp_path, {"seed": 1, "camera": {"width": 5}})
    assert (tmp_path / "0.png").read_bytes() == b"x"
    begin(tmp_path, {"seed": 1, "camera": {"width": 5}}, overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == [MADE_FROM]


def test_files_of_unknown_origin_are_not_continued(tmp_path):
    (tmp_path / ".lock").touch()
    begin(tmp_path, {"seed": 1})
    (tmp_path / MADE_FROM).unlink()
    (tmp_path / "0.png").write_bytes(b"x")
    with pytest.raises(UserError, match=r"holds files, but no made_from.json"):
        begin(tmp_path, {"seed": 1})


def test_a_digest_tells_files_and_their_order_apart(tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    one.write_bytes(b"ab")
    two.write_bytes(b"c")
    assert digest(one) == digest(b"ab") != digest(two)
    assert digest(one, two) != digest(two, one) != digest(b"a", b"bc") and len(digest(one)) == 16
    assert digest(tmp_path / "none") == digest(b"")
