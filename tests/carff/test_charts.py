import numpy as np
import pytest
from matplotlib.figure import Figure

from carff.charts import (
    accuracy_recall_chart,
    calibration_chart,
    closed_loop_chart,
    confusion_heatmap,
    latent_map,
    planning_chart,
    psnr_curve,
    psnr_heatmap,
)
from carff.forecast_metrics import accuracy_recall_curves, branch_calibration
from carff.planning_metrics import Episode, closed_loop_results, planning_table
from carff.state_style import state_style
from hashnerf.figure_style import png_bytes

PNG = b"\x89PNG"
STYLE = state_style([(0, 0), (0, 1), (1, 0)], ("absent", "present"))


def _texts(figure: Figure) -> list[str]:
    return [text.get_text() for axes in figure.axes for text in axes.texts]


def test_psnr_curve_has_minutes():
    figure = psnr_curve(np.array([0.0, 120.0]), np.array([20.0, 30.0]))
    assert figure.axes[0].lines[0].get_xdata().tolist() == [0.0, 2.0]
    assert png_bytes(psnr_curve(np.array([0.0]), np.array([20.0]))).startswith(PNG)


def test_latent_map_separates_determined_from_ambiguous_views():
    points = np.arange(12.0).reshape(6, 2)
    figure = latent_map(points, np.array([0, 0, 1, 1, 2, 2]), np.array([True, False] * 3), STYLE)
    drawn = [len(group.get_offsets()) for group in figure.axes[0].collections]
    assert drawn == [1, 1, 1, 1, 1, 1, 0]
    assert png_bytes(latent_map(points, np.zeros(6, int), np.ones(6, bool), STYLE)).startswith(PNG)


def test_heatmap_prints_own_psnr_and_differences_elsewhere():
    style = state_style([(0, 0), (1, 0)], ("absent", "present"))
    matrix = np.array([[28.0, 23.5], [25.0, 27.0]])
    figure = psnr_heatmap(matrix, np.array([0, 1]), np.array([False, True]), np.eye(2, dtype=bool), style, "PSNR")
    assert _texts(figure) == ["28.0", "−4.5", "−2.0", "27.0"]
    assert [text.get_fontweight() for text in figure.axes[0].texts] == ["bold", "normal", "normal", "bold"]
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == [
        "toggled  absent t0",
        "predicted  present t0",
    ]


def test_heatmap_of_shared_and_identical_pictures():
    matrix = np.array([[np.inf, 20.0, np.inf]])
    equal = np.array([[True, False, True], [False, True, False], [True, False, True]])
    figure = psnr_heatmap(matrix, np.array([0]), np.array([True]), equal, STYLE, "PSNR")
    assert _texts(figure) == ["identical", "", "identical"]
    assert png_bytes(figure).startswith(PNG)


def test_confusion_prints_counts_and_survives_an_empty_row():
    figure = confusion_heatmap(np.array([[5, 0], [0, 0]]), ["a", "b"], ["a", "unknown"], "probe")
    assert _texts(figure) == ["5"] and png_bytes(figure).startswith(PNG)


def test_accuracy_recall_says_where_there_is_no_such_image():
    samples = np.random.default_rng(0).integers(2, size=(4, 3, 50))
    plausible = np.array([[True, True], [True, True], [True, False], [False, True]])
    both = accuracy_recall_chart(accuracy_recall_curves(samples, plausible, bootstraps=20), "Forecast")
    assert not _texts(both)
    clear = accuracy_recall_chart(accuracy_recall_curves(samples[2:], plausible[2:], bootstraps=20), "Forecast")
    assert _texts(clear) == ["no image of this kind in the data"]
    assert png_bytes(both).startswith(PNG)


def test_calibration_has_one_panel_a_class_and_names_empty_ones():
    result = branch_calibration(np.array([[0.6, 0.4]]), np.array([[0.5, 0.5]]), np.array([0]))
    texts = _texts(calibration_chart(result))
    assert texts == ["ECE 0.100\n1 views", "no such view", "no such view"]


def test_planning_chart_places_rates_intervals_and_the_papers_marks():
    rows = planning_table({("paper", 2): np.array([[False, False], [True, False]])}, np.array([True, False]))
    figure = planning_chart(rows, {("paper", 2): (0.6, 1.0)})
    left, right = figure.axes
    marks = [line.get_xdata() for line in left.lines if line.get_marker() == "D"]
    assert np.ravel(marks).tolist() == [0.6]
    dots = [float(np.ravel(line.get_xdata())[0]) for line in right.lines if line.get_marker() == "o"]
    assert dots == [0.0, 1.0, 0.5]
    assert [label.get_text() for label in left.get_yticklabels()] == [
        "always stop (under-confident)",
        "always go (over-confident)",
        "paper rule, n = 2",
    ]


def test_planning_chart_without_clear_images():
    figure = planning_chart(planning_table({}, np.array([True])), {})
    assert _texts(figure) == ["no such case", "no such case"]


@pytest.mark.parametrize("time", [4.0, None])
def test_closed_loop_chart_with_and_without_crossings(time):
    episode = Episode("risk", 0, False, False, True, True, time, 3)
    figure = closed_loop_chart(closed_loop_results([episode]))
    assert ("never crosses" in _texts(figure)) is (time is None)
    assert png_bytes(figure).startswith(PNG)
