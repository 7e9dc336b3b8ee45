import numpy as np
import pytest

from aerial2ground.localisation_charts import located_errors, located_paths, pose_errors
from hashnerf.figure_style import png_bytes

TRUTH = [[0.0, 0.0, 3.1], [1.0, 0.0, 0.0]]


def test_errors_by_hand_and_across_the_turn_of_the_angle():
    metres, degrees = pose_errors(TRUTH, [[0.3, 0.4, -3.1], [1.0, 0.0, 0.1]])
    assert metres.tolist() == pytest.approx([0.5, 0.0])
    # from 3.1 to -3.1 is 2 pi - 6.2 = 0.0832 radians
    assert degrees.tolist() == pytest.approx([np.degrees(2 * np.pi - 6.2), np.degrees(0.1)])


def test_one_line_a_trajectory_and_a_note_for_what_is_off_the_map():
    far = {"trajectory": "a_b", "truth": TRUTH, "ours": [[0.0, 0.1, 3.0], [50.0, 0.0, 0.0]]}
    figure = located_paths([far, far | {"baseline": TRUTH}])
    assert len(figure.axes) == 4
    assert figure.axes[1].get_title(loc="left") == "a b: Ours"
    assert [text.get_text() for text in figure.axes[1].texts] == ["1 off the map"]
    assert png_bytes(figure).startswith(b"\x89PNG")


def test_shares_end_at_all_pictures_and_medians_are_marked():
    track = {"trajectory": "a", "truth": TRUTH, "ours": [[0.1, 0.0, 3.1], [1.2, 0.0, 0.0]]}
    figure = located_errors({"layout_0": [track], "layout_1": [track]})
    curve, median = figure.axes[0].lines
    assert curve.get_xdata().tolist() == pytest.approx([0.1, 0.2]) and curve.get_ydata().tolist() == [0.5, 1.0]
    assert median.get_xdata()[0] == pytest.approx(0.15)
    assert png_bytes(figure).startswith(b"\x89PNG")
