"""Stages as processes: their cost adds up, their failure is ours."""

import pytest

from carff.pipeline import check_script_folder, note, read_timings, run_stage
from hashnerf.errors import UserError


def test_costs_add_up_and_the_peak_is_the_largest(tmp_path):
    note(tmp_path / "run", "a", 2.0, 100.0)
    note(tmp_path / "run", "a", 3.0, 80.0)
    assert read_timings(tmp_path / "run") == {"a": {"seconds": 5.0, "peak_memory_mb": 100.0}}


def test_a_stage_is_run_and_noted(tmp_path):
    run_stage("write", ["-c", f"open({str(tmp_path / 'done')!r}, 'w').write('x' * 10)"], tmp_path)
    assert (tmp_path / "done").read_text() == "x" * 10
    assert read_timings(tmp_path)["write"]["peak_memory_mb"] > 1


@pytest.mark.parametrize(("code", "status"), [("raise SystemExit(2)", 2), ("import os; os.kill(os.getpid(), 9)", 137)])
def test_a_failing_stage_ends_the_pipeline_with_its_status(tmp_path, code, status):
    with pytest.raises(SystemExit) as stop:
        run_stage("bad", ["-c", code], tmp_path)
    assert stop.value.code == status
    assert read_timings(tmp_path) == {}


def test_missing_scripts_are_a_sentence(tmp_path):
    with pytest.raises(UserError, match="run from a checkout"):
        check_script_folder(tmp_path)
