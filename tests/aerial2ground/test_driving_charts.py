"""Charts of drives: errors by hand, one panel a trajectory, a cross for every intervention."""

import numpy as np
import pytest

from aerial2ground.driving_charts import driven_paths, path_errors, rms_along
from aerial2ground.paths import Path
from hashnerf.figure_style import png_bytes

LINE = [[0.0, 0.0], [1.0, 0.0]]


def drive(method="ours", lateral=(0.03, 0.04, 0.1), back=((0.9, 0.1),), path="a"):
    track = [[0.1, 0.03], [0.2, 0.04], [0.9, 0.1]]
    errors = {"lateral": list(lateral), "heading": [0.0, 0.1, -0.2]}
    return {"trajectory": path, "method": method, "seed": 0, "track": track, "put_back": list(back)} | errors


def test_errors_along_the_path_by_hand():
    places, lateral, heading = rms_along(Path(np.array(LINE)), [drive(), drive(lateral=(0.05, 0.0, 0.1))])
    assert places.tolist() == [0.125, 0.375, 0.625, 0.875]
    # the first quarter holds 3, 4, 5 and 0 cm: the root of 50 / 4; nobody was in the second and third
    assert lateral[0] == pytest.approx(0.01 * np.sqrt(12.5)) and lateral[3] == pytest.approx(0.1)
    assert np.isnan(lateral[1:3]).all() and heading[3] == pytest.approx(0.2)


def test_a_panel_a_trajectory_and_a_cross_an_intervention():
    paths = {"a": LINE, "b_c": [[0.0, 0.0], [0.0, 2.0]]}
    figure = driven_paths(paths, [drive(), drive("imit", back=())])
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["a", "b c"]
    crosses = [len(group.get_offsets()) for group in figure.axes[0].collections]
    assert sum(crosses) == 1
    assert png_bytes(figure).startswith(b"\x89PNG")
    assert [text.get_text() for text in figure.legends[0].get_texts()][:2] == ["Imit", "Ours"]


@pytest.mark.parametrize("count", [1, 4])
def test_any_number_of_trajectories(count):
    paths = {f"path {k}": LINE for k in range(count)}
    drives = [drive(path=name) for name in paths]
    assert png_bytes(driven_paths(paths, drives)).startswith(b"\x89PNG")
    figure = path_errors(paths, drives, 0.175)
    assert len(figure.axes) == 2 * count
    assert any(line.get_ydata()[0] == 17.5 for line in figure.axes[0].lines), "where somebody intervenes"
