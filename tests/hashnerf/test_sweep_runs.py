"""Rows as processes: what is run, kept, skipped, tried again, and said of a row that fails."""

import json
import shutil

import pytest

from hashnerf import sweep_runs
from hashnerf.errors import UserError
from hashnerf.sweep import MEMORY, TIME, Figure
from hashnerf.sweep_runs import figure_of, finished_rows, run_sweep
from tests.hashnerf.sweeps import FIGURE, PLAN, calls, small_sweep


def run(tmp_path, sweep, **options):
    said = []
    return run_sweep(sweep, tmp_path / "runs", tmp_path, say=said.append, **options), said


def test_every_row_is_run_and_measured(tmp_path):
    sweep = small_sweep(tmp_path)
    results, said = run(tmp_path, sweep)
    figures = {one.row.name: one.figures for one in results}
    # steps 4, width 1: 20 + 4 - 1/10; seconds 4 x 1; parts 1 and 3, mean 2
    assert figures["steps_4"]["quality"] == pytest.approx(23.9)
    assert (figures["steps_4"]["seconds"], figures["steps_4"]["mean"]) == (4, 2)
    assert figures["combined_2"]["quality"] == pytest.approx(23.7)
    assert 0 < figures["base"][TIME] < 60 and figures["base"][MEMORY] > 1
    assert not any(one.reason for one in results) and all(one.commit and one.machine and one.date for one in results)
    assert calls(tmp_path / "runs/small/base") == ["train 2 1 []", "measure 2 1 []"]
    assert said[0] == "small 1/6: base" and "quality 21.90 dB" in said[1]


def test_time_and_memory_are_those_of_the_named_stages(tmp_path, monkeypatch):
    train = {"seconds": 8.0, "processor_seconds": 3.0, "peak_memory_mb": 50.0}
    timings = {"train": train, "measure": {"seconds": 9.0, "processor_seconds": 9.0, "peak_memory_mb": 70.0}}
    monkeypatch.setattr(sweep_runs, "read_timings", lambda folder: timings)
    results, _ = run(tmp_path, small_sweep(tmp_path), most=1)
    assert (results[0].figures[TIME], results[0].figures[MEMORY]) == (3.0, 50.0)


def test_a_finished_row_is_not_run_again_unless_its_commands_changed(tmp_path):
    sweep = small_sweep(tmp_path)
    before, _ = run(tmp_path, sweep)
    again, said = run(tmp_path, sweep)
    assert again == before and said == []
    assert finished_rows(sweep, tmp_path / "runs", tmp_path) == before
    moved = shutil.copytree(tmp_path, tmp_path / "elsewhere") and small_sweep(tmp_path)
    assert finished_rows(moved, tmp_path / "runs", tmp_path / "elsewhere") == before, "the scripts' place is no matter"
    other = small_sweep(tmp_path, options={"part": "train"})
    assert finished_rows(other, tmp_path / "runs", tmp_path) == []
    run(tmp_path, other, most=1)
    assert calls(tmp_path / "runs/small/base") == ["train 2 1 []", "measure 2 1 []"], "made anew, not on top"


def test_a_figure_that_is_new_in_the_sweep_is_measured(tmp_path):
    run(tmp_path, small_sweep(tmp_path), most=1)
    more = small_sweep(tmp_path, figures=PLAN["figures"] | {"width": FIGURE | {"key": "parts.a.m"}})
    assert finished_rows(more, tmp_path / "runs", tmp_path) == []
    results, _ = run(tmp_path, more, most=1)
    assert results[0].figures["width"] == 1


def test_a_row_that_was_interrupted_starts_anew(tmp_path):
    sweep = small_sweep(tmp_path)
    folder = tmp_path / "runs/small/base"
    folder.mkdir(parents=True)
    (folder / "calls").write_text("half a training\n")
    run(tmp_path, sweep, most=1)
    assert calls(folder) == ["train 2 1 []", "measure 2 1 []"]


def test_a_failing_row_has_a_reason_the_others_go_on_and_it_is_tried_again(tmp_path):
    knobs = {"steps": PLAN["knobs"]["steps"], "width": {"key": "width", "values": [1, 13, 3]}}
    sweep = small_sweep(tmp_path, knobs=knobs, pareto=None)
    results, said = run(tmp_path, sweep)
    bad = [one for one in results if one.reason]
    assert [one.row.name for one in bad] == ["width_13"] and bad[0].figures == {}
    assert bad[0].reason == "train ended with status 1: width is 13; give another"
    assert results[-1].row.name == "width_3" and results[-1].figures
    assert any("failed: train ended" in line for line in said)
    _, said = run(tmp_path, sweep)
    assert said[0].endswith("width_13") and len(said) == 2, "only the failed row"


def test_a_stage_that_was_told_to_stop_ends_the_sweep_without_a_result(tmp_path):
    sweep = small_sweep(tmp_path)
    (tmp_path / "fake.py").write_text("raise SystemExit(130)")
    with pytest.raises(SystemExit):
        run(tmp_path, sweep)
    assert finished_rows(sweep, tmp_path / "runs", tmp_path) == []
    assert not (tmp_path / "runs/small/width_3").exists()


def test_a_missing_figure_is_the_reason_and_names_file_and_key(tmp_path):
    figures = PLAN["figures"] | {"lost": {"file": "measure.json", "key": "parts.c.m", "unit": "", "better": "less"}}
    results, _ = run(tmp_path, small_sweep(tmp_path, figures=figures), most=1)
    assert results[0].reason == "measure.json: holds no number at parts.c.m" and results[0].figures == {}


@pytest.mark.parametrize(
    ("key", "value"), [("a", None), ("*.m", 3.0), ("b.m", 5.0), ("flag", None), ("word", None), ("x.*.y", None)]
)
def test_figures_are_read_by_dotted_keys(tmp_path, key, value):
    found = {"a": {"m": 1}, "b": {"m": 5}, "flag": True, "word": "w", "x": {"1": {"y": 2}, "2": {"y": None}}}
    (tmp_path / "f.json").write_text(json.dumps(found))
    figure = Figure("", True, "f.json", key)
    if value is not None:
        assert figure_of(tmp_path, figure) == value
        return
    with pytest.raises(UserError, match=r"f\.json: holds no number at"):
        figure_of(tmp_path, figure)


def test_a_file_that_no_stage_wrote_is_named(tmp_path):
    with pytest.raises(UserError, match=r"lost\.json: no stage wrote this file"):
        figure_of(tmp_path, Figure("", True, "lost.json", "a"))


def test_rows_start_from_a_copy_of_the_shared_run_that_is_made_once(tmp_path):
    shared = {"name": "first", "stages": {"begin": "fake.py --part begin"}}
    sweep = small_sweep(tmp_path, shared=shared)
    _, said = run(tmp_path, sweep, most=2)
    assert said[0] == "small, run first for all rows: begin"
    begun = ["begin 1 1 []"]
    assert calls(tmp_path / "runs/shared/first") == begun
    assert calls(tmp_path / "runs/small/steps_1") == [*begun, "train 1 1 []", "measure 1 1 []"]
    run(tmp_path, sweep, most=3)
    assert calls(tmp_path / "runs/shared/first") == begun, "once, for later calls too"
    run(tmp_path, small_sweep(tmp_path, shared=shared | {"options": {"width": 2}}), most=1)
    assert calls(tmp_path / "runs/shared/first") == ["begin 1 2 []"], "another run for other options"


def test_a_shared_run_that_fails_ends_the_sweep_with_its_reason(tmp_path):
    shared = {"name": "first", "stages": {"begin": "fake.py --part begin --width 13"}}
    with pytest.raises(UserError, match="begin ended with status 1: width is 13"):
        run(tmp_path, small_sweep(tmp_path, shared=shared))


def test_rows_side_by_side_come_back_in_order(tmp_path):
    results, _ = run(tmp_path, small_sweep(tmp_path), workers=2)
    assert [one.row.name for one in results] == [row.name for row in small_sweep(tmp_path).rows()]
    assert all(one.figures for one in results)
