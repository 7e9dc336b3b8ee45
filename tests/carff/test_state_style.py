import numpy as np
import pytest
from matplotlib.colors import to_rgb

from carff.state_style import UNKNOWN_COLOUR, state_style

PAIRS = [(branch, step) for branch in range(2) for step in range(3)]


def _luminance(colour: str) -> float:
    return float(np.dot(to_rgb(colour), [0.2126, 0.7152, 0.0722]))


@pytest.mark.parametrize(
    "states", [PAIRS, [(0, step) for step in range(10)], [(0, 0), (1, 0), (2, 0), (3, 0)], [(0, 0)]]
)
def test_every_state_has_its_own_name_and_colour(states):
    style = state_style(states)
    assert len(set(style.names)) == len(set(style.colours)) == len(states)


def test_later_steps_are_darker_in_every_branch():
    style = state_style(PAIRS, ("absent", "present"))
    assert style.names[5] == "present t2"
    for branch in range(2):
        shades = [_luminance(colour) for colour in style.colours[3 * branch : 3 * branch + 3]]
        assert shades == sorted(shades, reverse=True)


def test_single_branch_data_is_named_by_step_and_spread_over_one_scale():
    style = state_style([(0, step) for step in range(10)], ("absent",))
    assert style.names == tuple(f"t{step}" for step in range(10))
    shades = [_luminance(colour) for colour in style.colours]
    assert shades == sorted(shades, reverse=True)


def test_branches_without_a_name_get_letters_and_gaps_are_allowed():
    assert state_style([(0, 1), (2, 4)]).names == ("A t1", "C t4")
    assert state_style([(0, 0), (1, 0)], ("slow",)).names == ("slow t0", "B t0")


def test_what_is_no_state_is_unknown():
    style = state_style(PAIRS)
    assert style.name(-1) == style.name(6) == "unknown" and style.colour(-1) == UNKNOWN_COLOUR
    assert style.name(0) == style.names[0] and style.colour(5) == style.colours[5]
