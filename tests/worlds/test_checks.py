import pytest

from hashnerf.errors import UserError
from worlds.checks import check_between, check_one_of


@pytest.mark.parametrize("value", [0.0, 1.0, 0.5, 1])
def test_both_ends_belong_to_the_range(value):
    check_between("share", value, 0.0, 1.0)


@pytest.mark.parametrize("value", [-1e-9, 1.0 + 1e-9, float("nan"), float("inf"), float("-inf")])
def test_outside_and_not_a_number_are_one_sentence(value):
    with pytest.raises(UserError) as error:
        check_between("share", value, 0.0, 1.0)
    assert str(error.value) == f"share = {value} is out of range; give a number from 0.0 to 1.0."


def test_one_of():
    check_one_of("split", "test", ("train", "test"))
    with pytest.raises(UserError, match="split = 'tset' is not known; give one of train, test"):
        check_one_of("split", "tset", ("train", "test"))
