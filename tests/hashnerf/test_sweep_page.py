"""The page's tables and sentences, on results worked by hand."""

from dataclasses import replace

from hashnerf.sweep_page import monotonicity_lines, options_of, page, preset_lines, sweep_section, table_rows
from tests.hashnerf.sweeps import small_sweep
from tests.hashnerf.test_sweep_presets import results_of


def test_the_table_has_a_row_a_setting_and_marks_the_front(tmp_path):
    sweep = small_sweep(tmp_path)
    assert table_rows(sweep, results_of(sweep)) == [
        ["varied", "value", "**seconds**", "**quality**", "front"],
        ["base", "steps 2, width 1", "4.00 s", "22.00 dB", "●"],
        ["steps", "1", "2.00 s", "20.00 dB", "●"],
        ["steps", "4", "8.00 s", "23.00 dB", "●"],
        ["width", "3", "6.00 s", "21.50 dB", ""],
        ["combined", "steps 1, width 3", "3.00 s", "19.00 dB", ""],
        ["combined", "steps 4, width 3", "9.00 s", "23.05 dB", "●"],
    ]


def test_what_more_cost_does_not_buy_is_said(tmp_path):
    sweep = small_sweep(tmp_path)
    assert monotonicity_lines(sweep, results_of(sweep)) == [
        "Where more cost buys less accuracy, by more than chance (0.1 dB):",
        "",
        "- width: 3 costs more than 1 and is worse: 21.50 dB after 22.00 dB.",
    ]
    tolerant = small_sweep(tmp_path, noise=1)
    assert monotonicity_lines(tolerant, results_of(tolerant)) == [
        "Along no knob is a dearer value less accurate than a cheaper one by more than chance (1 dB)."
    ]


def test_presets_say_rule_figures_and_options(tmp_path):
    sweep = small_sweep(tmp_path)
    text = preset_lines(sweep, results_of(sweep))
    assert "| fast | cheapest within 2.5 dB of the best | 4.00 s | 22.00 dB | the base |" in text
    assert "| accurate | the best | 9.00 s | 23.05 dB | `--steps=4 --width=3` |" in text
    assert preset_lines(small_sweep(tmp_path, presets=None), results_of(sweep)) == ""


def test_options_of_several_keys_are_written_out(tmp_path):
    knobs = {"size": {"keys": ["w", "h"], "values": [[4, [1, 2]], [8, [3, 4]]]}}
    sweep = small_sweep(tmp_path, knobs=knobs, pareto=None)
    base, other = results_of(sweep)[:2]
    assert options_of(sweep, base) == [] and options_of(sweep, other) == ["--w=8", "--h=[3, 4]"]


def test_a_section_says_what_was_measured_where_and_what_failed(tmp_path):
    sweep = small_sweep(tmp_path, options={"seed": 3})
    results = [
        replace(one, machine="a laptop", commit="abc", date="2026-11-29 05:00 UTC") for one in results_of(sweep)[:3]
    ]
    results[1] = replace(results[1], figures={}, reason="it broke", commit="def")
    text = sweep_section(sweep, results, "chart.png")
    assert text.startswith("## A small sweep\n\nWhat it is.\n\n")
    assert "2 of 6 rows; a laptop; commit abc, def; 2026-11-29; seed 3." in text
    assert "![Accuracy against cost](chart.png)" in text and "- **steps_1** failed: it broke" in text
    assert "| steps | 1 | – | – |  |" in text


def test_a_sweep_whose_rows_all_failed_has_reasons_and_no_chart(tmp_path):
    sweep = small_sweep(tmp_path)
    text = sweep_section(sweep, [replace(results_of(sweep)[0], figures={}, reason="no disk")], "chart.png")
    assert "**base** failed: no disk" in text and "chart.png" not in text and "0 of 6 rows" in text


def test_the_page_joins_its_parts():
    text = page(["## A", "## B"], "python a.py", "## Whole")
    assert text.startswith("# Speed against accuracy\n\n`python a.py` writes this page.")
    assert text.endswith("## A\n\n## B\n\n## Whole\n")
