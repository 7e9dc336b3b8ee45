"""The results page says what was met and what was missed, and by which run."""

import json

import pytest

from carff.results_page import publish
from carff.targets import TARGETS
from hashnerf.errors import UserError

RUN = {
    "name": "demo", "preset": "fast", "scenario": "intersection", "command": "python x.py", "machine": "two cores",
    "date": "2026-01-01", "commit": "abc", "seed": 0, "versions": "Python 3.11",
}  # fmt: skip


def write_report(folder, measured):
    rows = [
        {"key": t.key, "label": t.label, "comparison": t.comparison, "target": t.fast, "measured": None, "met": None}
        for t in TARGETS
    ]
    row = next(row for row in rows if row["key"] == "nerf.psnr_matched_db")
    row.update(measured=measured, met=measured >= 24.5)
    folder.mkdir()
    (folder / "report.json").write_text(
        json.dumps({"run": RUN, "nerf": {"psnr_matched_db": measured}, "targets": rows})
    )
    return folder


def test_met_missed_and_not_run_are_told_apart(tmp_path):
    runs = [write_report(tmp_path / "a", 26.0), write_report(tmp_path / "b", 20.0)]
    text = publish(runs, tmp_path / "out").read_text()
    line = next(line for line in text.splitlines() if "nerf.psnr_matched_db" in line)
    assert "26.0 dB (met, target ≥ 24.5 dB)" in line
    assert "20.0 dB (**missed**, target ≥ 24.5 dB)" in line
    assert "not run" in text and "python x.py" in text
    assert json.loads((tmp_path / "out" / "a.json").read_text())["run"]["commit"] == "abc"


def test_a_report_of_other_figures_is_a_sentence(tmp_path):
    run = write_report(tmp_path / "a", 26.0)
    document = json.loads((run / "report.json").read_text())
    document["targets"] = document["targets"][1:]
    (run / "report.json").write_text(json.dumps(document))
    with pytest.raises(UserError, match=r"demo: its report lacks seconds_total; run scripts/evaluate_carff.py again"):
        publish([run], tmp_path / "out")


def test_a_foreign_report_is_a_sentence_and_nothing_is_written(tmp_path):
    (tmp_path / "report.json").write_text("{}")
    with pytest.raises(UserError, match=r"report.json: is no report of scripts/evaluate_carff.py"):
        publish([tmp_path], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_run_without_report_is_a_sentence(tmp_path):
    with pytest.raises(UserError, match=r"evaluate_carff.py for it first"):
        publish([tmp_path], tmp_path / "out")
    assert not (tmp_path / "out").exists()
