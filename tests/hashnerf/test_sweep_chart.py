"""What the chart of a sweep shows."""

import pytest

from hashnerf.figure_style import VERMILION, png_bytes
from hashnerf.sweep_chart import sweep_chart
from hashnerf.sweep_presets import chosen_presets
from hashnerf.sweep_runs import Result
from tests.hashnerf.sweeps import FIGURE, PLAN, small_sweep
from tests.hashnerf.test_sweep_presets import results_of


def lines_of(figure):
    return {line.get_label(): line for line in figure.axes[0].lines}


def test_a_line_a_knob_through_the_base_and_the_front(tmp_path):
    sweep = small_sweep(tmp_path)
    results = results_of(sweep)
    figure = sweep_chart(sweep, results, chosen_presets(sweep, results))
    lines = lines_of(figure)
    assert {"front", "steps", "width", "combinations", "base"} <= set(lines)
    assert lines["steps"].get_xydata().tolist() == [[2, 20], [4, 22], [8, 23]]
    assert lines["width"].get_xydata().tolist() == [[4, 22], [6, 21.5]]
    assert lines["front"].get_xydata().tolist() == [[2, 20], [4, 22], [8, 23], [9, 23.05]]
    assert lines["front"].get_color() == VERMILION
    axes = figure.axes[0]
    assert axes.get_xlabel() == "seconds (s)" and axes.get_ylabel() == "quality (dB)"
    assert sorted(text.get_text() for text in axes.texts) == ["accurate", "fast, balanced"]
    assert axes.get_xscale() == "log" and not axes.yaxis_inverted()
    assert png_bytes(figure).startswith(b"\x89PNG")


def test_better_is_up_and_shares_are_shown_in_per_cent(tmp_path):
    figures = PLAN["figures"] | {"errors": FIGURE | {"key": "psnr", "unit": "%"}}
    sweep = small_sweep(tmp_path, figures=figures, accuracy="errors")
    results = [Result(row, {"seconds": 1.0 + n, "errors": 0.1 / (1 + n)}) for n, row in enumerate(sweep.rows())]
    figure = sweep_chart(sweep, results, {})
    assert figure.axes[0].yaxis_inverted()
    assert lines_of(figure)["base"].get_ydata()[0] == pytest.approx(10)


def test_one_row_is_enough(tmp_path):
    sweep = small_sweep(tmp_path)
    results = results_of(sweep)[:1]
    assert png_bytes(sweep_chart(sweep, results, chosen_presets(sweep, results)))
