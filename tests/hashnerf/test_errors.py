"""The two errors a user can cause: their messages are all a user sees."""

from hashnerf.errors import DataError, UserError


def test_one_problem_and_several():
    assert str(DataError("set", ["a.png: broken"])) == "set: 1 problem\n  a.png: broken"
    error = DataError("set", ["a", "b"])
    assert str(error) == "set: 2 problems\n  a\n  b"
    assert error.problems == ["a", "b"]
    assert isinstance(error, UserError)
