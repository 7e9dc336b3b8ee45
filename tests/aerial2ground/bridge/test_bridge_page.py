import json
import math

import pytest

from aerial2ground.bridge.bridge_page import PARTS, failed, page, read_parts
from hashnerf.errors import UserError
from hashnerf.numeric_rows import Measured, RowsRun

ROWS = {
    "R01": {"requirement": "nothing moves"},
    "R23": {"requirement": "poses", "reason": "there are none"},
    "R24": {"requirement": "stops in time"},
}
ABOUT = {"commit": "abc", "machine": "a laptop"}


def drive(interventions):
    return {"laps": 5, "interventions": interventions, "position_rmse": 0.01, "yaw_rmse": 1.5}


def parts():
    one = {"seconds": 60.0, "median": 20.0, "p99": 22.0, "longest": 25.0, "damaged": 0, "faults": 0}
    found = {
        "faults": [{"name": "kill", "what": "killed", "allowed": 0.15, "took": [0.01, 0.03, 0.02]}],
        "laps": [{"trajectory": "outer_loop", "bridge": drive(1), "simulator": drive(0)}],
        "period": [one | {"busy": 1}, one | {"busy": 2, "p99": 29.0}],
        "noise": {"sent": 1_000_000, "alive": True, "growth": 0.0, "outside": 0, "steering": 3.0, "speed": 2.4},
        "latency": [["camera", 1.0, 2.0], ["policy", 0.7, 1.1]],
        "chart": "480 periods, 0 of them with other bytes",
        "coverage": {"percent": 100.0, "lines": 700, "branches": 200},
    }
    survivor = {"file": "a.py", "line": 3, "before": "x | y", "after": "x", "outcome": "survived"}
    mutants = {
        "sample": 0.5,
        "killed_share": 0.96,
        "mutants": 25,
        "counts": {"killed": 24, "survived": 1},
        "survivors": [survivor],
    }
    return {name: ABOUT | {"found": value} for name, value in found.items()} | {"mutants": ABOUT | mutants}


def run(took=40.0, passed=True):
    lines = (
        Measured("R01", "motion frames", 0.0, 0.0, "tests.a"),
        Measured("R24", "e-stop", took, 50.0, "tests.b", "ms"),
    )
    return RowsRun(lines, {"tests.a": True, "tests.b": passed})


def test_the_page_tells_what_was_measured():
    text = page(ROWS, run(), parts(), "About.")
    assert "2 tested, 1 excused, failed: none | met" in text
    assert "| 1 in 5 laps of each of 1 trajectories | met |" in text
    assert "20.0, 29.0 ms; 60 s, 2 busy processes | met" in text
    assert "| killed | 150 | 20 | 30 | 3 | 0 |" in text
    assert "| R24 | stops in time | e-stop | 40 ms | 50 ms | yes | `tests.b` |" in text
    assert "not tested: there are none" in text
    assert "25 small faults (50% of all, drawn at random), one at a time" in text
    assert "96.0% of 25 | met" in text and "| a.py:3 | `x \\| y` | `x` |" in text
    assert "Replayed: 480 periods, 0 of them" in text and "(../images/bridge_drive.png)" in text
    assert "1000000 bytes: still running, 0 frames beyond, +0.0 MB | met" in text


@pytest.mark.parametrize(
    ("part", "key", "value", "line"),
    [
        ("laps", "bridge", drive(2), "2 in 5 laps of each of 1 trajectories | **missed**"),
        ("period", "p99", 31.0, "20.0, 31.0 ms; 60 s, 1 busy processes | **missed**"),
        ("period", "median", 21.5, "**missed**"),
        ("faults", "took", [0.1, math.inf], "2 faults, too late: kill | **missed**"),
    ],
)
def test_what_was_missed_is_said(part, key, value, line):
    changed = parts()
    changed[part]["found"][0][key] = value
    if part == "period":
        changed[part]["found"].pop()
    assert line in page(ROWS, run(), changed, "About.")


@pytest.mark.parametrize(("key", "value"), [("alive", False), ("growth", 6.0), ("outside", 1), ("sent", 999_999)])
def test_noise_that_did_something_is_a_miss(key, value):
    changed = parts()
    changed["noise"]["found"][key] = value
    text = page(ROWS, run(), changed, "About.")
    assert "**missed**" in next(line for line in text.splitlines() if line.startswith("| noise"))


def test_a_time_that_passed_its_test_beside_others_must_still_be_as_required():
    assert failed(ROWS, run(took=60.0)) == ["R24"]
    assert failed(ROWS, run(passed=False)) == ["R24"]
    assert "| 60 ms | 50 ms | **no** |" in page(ROWS, run(took=60.0), parts(), "")


def test_a_requirement_without_test_or_reason_is_named():
    with pytest.raises(UserError, match="R02: no test measures it"):
        page(ROWS | {"R02": {"requirement": "arming"}}, run(), parts(), "")
    with pytest.raises(UserError, match=r"tests\.c: failed before it measured anything"):
        page(ROWS, RowsRun(run().lines, {**run().passed, "tests.c": False}), parts(), "")


def test_a_part_that_is_missing_is_named(tmp_path):
    for name, part in parts().items():
        (tmp_path / f"{name}.json").write_text(json.dumps(part))
    assert set(read_parts(tmp_path)) == set(PARTS)
    (tmp_path / "mutants.json").unlink()
    with pytest.raises(UserError, match=r"mutants\.json: no such file; run scripts/mutate_guard\.py first"):
        read_parts(tmp_path)
