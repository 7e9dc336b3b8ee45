"""The figure of decisions along the approach."""

from dataclasses import asdict

import pytest

from carff.approach_chart import KIND_COLOURS, approach_chart
from carff.planning_metrics import ApproachPoint
from carff.state_style import state_style
from hashnerf.figure_style import png_bytes

STATES = [(0, 0), (0, 1), (1, 0), (1, 1)]


def chart(*points: ApproachPoint):
    return approach_chart([asdict(point) for point in points], state_style(STATES), STATES)


def test_a_panel_per_state_that_was_asked_and_a_cross_per_wrong_decision():
    figure = chart(
        ApproachPoint(0, 0, 9.0, "other", 0.5, False),
        ApproachPoint(0, 0, 1.0, "clear", 0.0, True),
        ApproachPoint(1, 0, 9.0, "hidden", 0.1, True),  # wrong
        ApproachPoint(1, 0, 8.0, "hidden", 0.5, False),
        ApproachPoint(1, 0, 1.0, "shown", 1.0, False),
    )
    drawn = [axes for axes in figure.axes if axes.get_title(loc="left")]
    assert [axes.get_title(loc="left") for axes in drawn] == ["A t0", "B t0"]
    wrong = list(KIND_COLOURS).index("hidden") * 2 + 1
    crosses = [[len(one.get_offsets()) for one in axes.collections[1::2]] for axes in drawn]
    assert crosses == [[0, 0, 0, 0], [1, 0, 0, 0]]
    assert drawn[1].collections[wrong].get_offsets().tolist() == [[9.0, 0.1]]
    assert drawn[0].get_xlim()[0] > drawn[0].get_xlim()[1], "the ego drives to the right"


@pytest.mark.parametrize("count", [0, 1, 3])
def test_any_number_of_states_can_be_drawn(count):
    points = [ApproachPoint(*state, 2.0, "clear", 0.0, True) for state in STATES[:count]]
    assert png_bytes(chart(*points)).startswith(b"\x89PNG")
