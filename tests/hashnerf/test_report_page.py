"""The page and the figures of a run, whatever the system; tests/carff/test_report.py has more on real reports."""

import dataclasses
import json
import math

import pytest

from hashnerf.errors import UserError
from hashnerf.figure_style import new_figure, png_bytes
from hashnerf.report_page import Panel, ReportKind, Section, print_targets, write_report
from hashnerf.report_tables import Table
from hashnerf.run_info import RunInfo
from hashnerf.targets import Target, judge, lookup

RUN = RunInfo("demo", "fast", "town", "make demo", "2 cores", "2026-01-01 12:00", "abc1234", 0, "Python 3.11")
TARGETS = (Target("total.error_m", "error", "<=", "m", 0.1, 0.05),)
SECTIONS = (
    Section(
        "drive",
        "Drive: once round",
        "What the car does.",
        (Panel("path", "The path", "Look at the bends.", "drive"),),
        lambda results: [Table(("way", "error"), (("left", f"{lookup(results, 'drive.error_m')}"),))],
    ),
)
KIND = ReportKind(
    title="Driving report",
    sections=SECTIONS,
    required_keys=lambda results: [f"drive.{key}" for key in results.get("wanted", ("error_m",))],
    derived=lambda results: {**results, "total": {"error_m": lookup(results, "drive.error_m")}},
    judge=lambda results, preset, reasons: judge(TARGETS, results, preset, reasons),
    intro="From <above>.",
    footnote="Errors are RMSE.",
)


def test_the_kind_of_report_decides_what_the_page_tells(tmp_path):
    picture = png_bytes(new_figure(0.3, 0.2))
    page = write_report(tmp_path, KIND, RUN, {"drive": {"error_m": 0.07}}, {"path": picture}).read_text()
    assert "<title>demo · Driving report</title>" in page and "From &lt;above&gt;." in page
    assert "Errors are RMSE.</footer>" in page and "<td>0.07</td>" in page and "✓ met" in page
    assert "<td>≤ 0.1 m</td>" in page and "0.070 m" in page
    document = json.loads((tmp_path / "report.json").read_text())
    assert document["total"]["error_m"] == 0.07 and document["targets"][0]["met"] is True


def test_a_kind_without_intro_and_footnote_has_no_empty_places(tmp_path):
    kind = ReportKind("R", SECTIONS, lambda results: [], dict, lambda results, preset, reasons: [])
    page = write_report(tmp_path, kind, RUN, {}, {}).read_text()
    assert "<p style" not in page and "beside this page.</footer>" in page and "this figure was not drawn" in page


def test_required_keys_may_depend_on_the_results(tmp_path):
    results = {"wanted": ["error_m", "crashes"], "drive": {"error_m": 0.2}}
    with pytest.raises(UserError, match=r"no value for drive.crashes"):
        write_report(tmp_path, KIND, RUN, results, {})
    assert not any(tmp_path.iterdir())
    write_report(tmp_path, KIND, RUN, results, {}, {"drive.crashes": "nobody counted"})


def test_a_figure_that_no_section_shows_is_refused(tmp_path):
    with pytest.raises(ValueError, match="pathh"):
        write_report(tmp_path, KIND, RUN, {"drive": {"error_m": 0.2}}, {"pathh": b""})


@pytest.mark.parametrize("preset", ["fast", "another"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_k22_a_figure_that_is_not_finite_is_no_success(tmp_path, capsys, preset, value, numeric_row):
    """With or without a limit for it; the report itself is there to be looked at."""
    write_report(tmp_path, KIND, dataclasses.replace(RUN, preset=preset), {"drive": {"error_m": value}}, {})
    passed = []
    with pytest.raises(UserError, match=r"total\.error_m not finite; a stage has broken down"):
        print_targets(tmp_path)
        passed.append(value)
    assert "not finite" in capsys.readouterr().out
    numeric_row("K22", f"a figure of {value}, preset '{preset}': exit 0", len(passed))


def test_targets_are_printed(tmp_path, capsys):
    write_report(tmp_path, KIND, RUN, {"drive": {"error_m": 0.2}}, {})
    print_targets(tmp_path)
    write_report(tmp_path, KIND, RUN, {"drive": {"error_m": None}}, {}, {"drive": "no road", "total": "no road"})
    print_targets(tmp_path)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split() for line in lines] == [["total.error_m", "0.2", "missed"], ["total.error_m", "not", "run"]]
