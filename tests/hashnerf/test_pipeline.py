"""Stages as processes: their cost adds up, their failure is ours."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from hashnerf import pipeline
from hashnerf.errors import UserError
from hashnerf.pipeline import (
    check_script_folder,
    log_of,
    note,
    read_timings,
    run_stage,
    run_stages_together,
    timed_phase,
    total_seconds,
)

ROOT = Path(__file__).resolve().parents[2]
# Waits for Ctrl-C, then leaves a file behind, as a training leaves a checkpoint.
PATIENT = """
import pathlib, sys, time
place = pathlib.Path(sys.argv[1])
try:
    place.with_suffix(".started").touch()
    time.sleep(60)
except KeyboardInterrupt:
    place.touch()
    sys.exit(130)
"""


def test_costs_add_up_and_the_peak_is_the_largest(tmp_path):
    note(tmp_path / "run", "a", 2.0, 100.0)
    note(tmp_path / "run", "a", 3.0, 80.0)
    assert read_timings(tmp_path / "run") == {"a": {"seconds": 5.0, "peak_memory_mb": 100.0}}


def test_a_stage_is_run_and_noted(tmp_path):
    run_stage("write", ["-c", f"open({str(tmp_path / 'done')!r}, 'w').write('x' * 10)"], tmp_path)
    assert (tmp_path / "done").read_text() == "x" * 10
    assert read_timings(tmp_path)["write"]["peak_memory_mb"] > 1
    assert read_timings(tmp_path)["write"]["processor_seconds"] > 0


def test_processor_time_adds_up_and_waiting_is_none(tmp_path):
    for _ in range(2):
        note(tmp_path, "a", 5.0, 1.0, processor_seconds=0.25)
    assert read_timings(tmp_path)["a"]["processor_seconds"] == 0.5
    run_stage("sleep", ["-c", "import time; time.sleep(1.5)"], tmp_path)
    slept = read_timings(tmp_path)["sleep"]
    assert slept["processor_seconds"] < slept["seconds"]


def test_a_quiet_stage_prints_to_its_log(tmp_path, capfd):
    code = "import sys; print('out'); print('err', file=sys.stderr); raise SystemExit(3)"
    with pytest.raises(SystemExit) as stop:
        run_stage("a b", ["-c", code], tmp_path, quiet=True)
    assert stop.value.code == 3 and capfd.readouterr() == ("", "")
    assert log_of(tmp_path, "a b") == tmp_path / "logs" / "a_b.log"
    assert sorted(log_of(tmp_path, "a b").read_text().split()) == ["err", "out"]
    run_stage("a b", ["-c", "pass"], tmp_path, quiet=True)
    assert "a b" in read_timings(tmp_path)


@pytest.mark.parametrize(("code", "status"), [("raise SystemExit(2)", 2), ("import os; os.kill(os.getpid(), 9)", 137)])
def test_a_failing_stage_ends_the_pipeline_with_its_status(tmp_path, code, status):
    with pytest.raises(SystemExit) as stop:
        run_stage("bad", ["-c", code], tmp_path)
    assert stop.value.code == status
    assert read_timings(tmp_path) == {}


def test_missing_scripts_are_a_sentence(tmp_path):
    (tmp_path / "train_pcvae.py").touch()
    check_script_folder(tmp_path, "train_pcvae.py")
    with pytest.raises(UserError, match="run from a checkout"):
        check_script_folder(tmp_path, "train_pcvae.py", "train_nerf.py")


def test_what_runs_within_a_phase_is_not_added_up():
    stages = {
        "data": {"seconds": 2.0, "peak_memory_mb": 1.0},
        "towns": {"seconds": 5.0, "peak_memory_mb": 1.0},
        "town 1": {"seconds": 5.0, "peak_memory_mb": 1.0, "within": "towns"},
        "town 2": {"seconds": 4.0, "peak_memory_mb": 1.0, "within": "towns"},
    }
    assert total_seconds(stages) == 7.0 and total_seconds({}) == 0


def test_stages_that_wait_for_each_other_run_side_by_side(tmp_path):
    meet = textwrap.dedent("""
        import pathlib, sys, time
        own, other = map(pathlib.Path, sys.argv[1:])
        own.touch()
        end = time.monotonic() + 60
        while not other.exists() and time.monotonic() < end:
            time.sleep(0.01)
        sys.exit(not other.exists())
    """)
    a, b = str(tmp_path / "a"), str(tmp_path / "b")
    run_stages_together([("one", ["-c", meet, a, b]), ("two", ["-c", meet, b, a])], tmp_path / "run", 2, "both")
    stages = read_timings(tmp_path / "run")
    assert list(stages)[-1] == "both" and "within" not in stages["both"]
    assert [stages[name]["within"] for name in ("one", "two")] == ["both", "both"]
    assert total_seconds(stages) == stages["both"]["seconds"] >= max(stages[n]["seconds"] for n in ("one", "two"))
    assert stages["both"]["peak_memory_mb"] == max(stages[n]["peak_memory_mb"] for n in ("one", "two")) > 1


def test_no_more_than_the_workers_at_a_time_and_output_in_files(tmp_path, capfd):
    lonely = textwrap.dedent(f"""
        import os, sys, time
        os.mkdir({str(tmp_path / "lock")!r})
        time.sleep(0.1)
        print("hello from", sys.argv[1])
        os.rmdir({str(tmp_path / "lock")!r})
    """)
    run_stages_together([(name, ["-c", lonely, name]) for name in ("view 1", "view 2", "view 3")], tmp_path, 1)
    assert (tmp_path / "logs" / "view_2.log").read_text() == "hello from view 2\n"
    assert "hello" not in capfd.readouterr().out
    assert read_timings(tmp_path)["view 1 + view 2 + view 3"]["seconds"] >= 0.3


def test_the_first_failure_stops_the_rest_and_shows_its_output(tmp_path, capfd):
    saved = tmp_path / "saved"
    fail = textwrap.dedent(f"""
        import pathlib, sys, time
        while not pathlib.Path({str(saved.with_suffix(".started"))!r}).exists():
            time.sleep(0.01)
        sys.exit("the roads are not connected")
    """)
    never = f"open({str(tmp_path / 'never')!r}, 'w')"
    stages = [("long", ["-c", PATIENT, str(saved)]), ("bad", ["-c", fail]), ("later", ["-c", never])]
    with pytest.raises(SystemExit) as stop:
        run_stages_together(stages, tmp_path / "run", 2, "all")
    assert stop.value.code == 1
    assert "bad | the roads are not connected" in capfd.readouterr().out
    assert saved.exists(), "the other stage was asked to stop and could save"
    assert not (tmp_path / "never").exists()
    assert list(read_timings(tmp_path / "run")) == ["all"], "time that was spent counts when the run is continued"


def test_a_stage_that_does_not_stop_is_killed(tmp_path, monkeypatch):
    monkeypatch.setattr(pipeline, "PATIENCE", 0.2)
    ready = tmp_path / "ready"
    deaf = "import pathlib, signal, sys, time; signal.signal(signal.SIGINT, signal.SIG_IGN); "
    deaf += f"pathlib.Path({str(ready)!r}).write_text(str(__import__('os').getpid())); time.sleep(60)"
    fail = (
        f"import pathlib, time\nwhile not pathlib.Path({str(ready)!r}).exists(): time.sleep(0.01)\nraise SystemExit(3)"
    )
    with pytest.raises(SystemExit) as stop:
        run_stages_together([("deaf", ["-c", deaf]), ("bad", ["-c", fail])], tmp_path / "run", 2)
    assert stop.value.code == 3
    with pytest.raises(ProcessLookupError):
        os.kill(int(ready.read_text()), 0)


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_signal_stops_every_stage_and_leaves_none_behind(tmp_path, number, status):
    saved = [tmp_path / "a", tmp_path / "b"]
    stages = [(path.name, ["-c", PATIENT, str(path)]) for path in saved]
    # in the background Ctrl-C is ignored: it must still reach a run that is in the foreground, and all of its stages
    handler = "SIG_IGN" if number != signal.SIGINT else "default_int_handler"
    code = textwrap.dedent(f"""
        import pathlib, signal
        signal.signal(signal.SIGINT, signal.{handler})
        from hashnerf.command_line import run_main
        from hashnerf.pipeline import run_stages_together
        run_main(lambda: run_stages_together({stages!r}, pathlib.Path({str(tmp_path / "run")!r}), 2, "both"))
    """)
    process = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 120
    while not all(path.with_suffix(".started").exists() for path in saved):
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.02)
    process.send_signal(number)  # to this process alone: it has to pass it on
    _, errors = process.communicate(timeout=120)
    assert process.returncode == status and "Traceback" not in errors
    assert all(path.exists() for path in saved)
    assert list(read_timings(tmp_path / "run")) == ["both"]


def test_stages_of_one_name_are_refused(tmp_path):
    with pytest.raises(UserError, match="a name of its own"):
        run_stages_together([("a 1", ["-c", ""]), ("a_1", ["-c", ""])], tmp_path, 2)


def test_a_phase_can_be_timed_around_anything(tmp_path):
    with timed_phase("phase", tmp_path):
        note(tmp_path, "part", 100.0, 7.0, within="phase")
    stages = read_timings(tmp_path)
    assert total_seconds(stages) == stages["phase"]["seconds"] < 50 and stages["phase"]["peak_memory_mb"] == 7.0
