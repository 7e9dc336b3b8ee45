"""Parts of a page of results; tests/carff/test_results_page.py has whole pages."""

import json

import pytest

from hashnerf.errors import UserError
from hashnerf.report_tables import Table
from hashnerf.results_page import (
    PROVENANCE,
    copy_reports,
    markdown_table,
    provenance,
    read_reports,
    table_lines,
    target_table,
)
from hashnerf.targets import Target

TARGET = Target("error_m", "error", "<=", "m", 0.1, 0.05)


def report(measured, met, reason="", limit=0.1):
    row = {"key": "error_m", "comparison": "<=", "target": limit, "measured": measured, "met": met, "reason": reason}
    return {"run": {key: f"a {key}" for key in PROVENANCE}, "error_m": measured, "targets": [row]}


@pytest.mark.parametrize(
    ("given", "cell"),
    [
        (report(0.04, True), "0.040 m (met, target ≤ 0.100 m)"),
        (report(0.4, False), "0.400 m (**missed**, target ≤ 0.100 m)"),
        (report(0.4, None, "a part of it", None), "0.400 m (a part of it)"),
        (report(None, None), "not run"),
    ],
)
def test_a_cell_says_what_was_reached_and_whether_it_is_enough(given, cell):
    lines = target_table([given], [TARGET], "x.py")
    assert lines[0] == "| figure | a name |" and lines[2] == f"| error (`error_m`) | {cell} |"


def test_reports_are_read_and_copied(tmp_path):
    run, out = tmp_path / "town", tmp_path / "out"
    with pytest.raises(UserError, match=r"town: holds no report.json; run x.py for it first"):
        read_reports([run], "x.py")
    with pytest.raises(UserError, match="name at least one run"):
        read_reports([], "x.py")
    run.mkdir()
    (run / "report.json").write_text(json.dumps(report(0.4, False)))
    (given,) = read_reports([run], "x.py")
    copy_reports([run], out)
    assert json.loads((out / "town.json").read_text()) == given
    assert provenance([given])[2].startswith("| a name | a scenario |")


def test_runs_of_one_name_would_share_one_copy(tmp_path):
    for parent in ("a", "b"):
        (tmp_path / parent / "run").mkdir(parents=True)
        (tmp_path / parent / "run" / "report.json").write_text(json.dumps(report(0.04, True)))
    with pytest.raises(UserError, match="have the same name"):
        read_reports([tmp_path / "a" / "run", tmp_path / "b" / "run"], "x.py")


def test_a_table_without_rows_leaves_no_trace():
    assert table_lines(Table(("a", "b"), ())) == []
    assert table_lines(Table(("a", "b"), (("1", "2"),), "Note.")) == [
        "| a | b |",
        "|---|---|",
        "| 1 | 2 |",
        "",
        "Note.",
    ]


def test_rows_as_markdown():
    assert markdown_table([["a", "b"], ["1", "2"]]) == "| a | b |\n|---|---|\n| 1 | 2 |"
