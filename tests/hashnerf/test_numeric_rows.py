"""The page of numbered rows: every row is measured or excused, in every precision."""

import subprocess
import sys
from pathlib import Path

import pytest

from hashnerf.errors import UserError
from hashnerf.numeric_rows import HEADER, Measured, RowsRun, page_lines, read_rows, read_run

ROOT = Path(__file__).resolve().parents[2]
ROWS = {"N1": {"hazard": "it breaks"}, "N2": {"hazard": "nothing to break", "reason": "we have none"}}


def run_of(passed: bool, *errors: float) -> RowsRun:
    return RowsRun(tuple(Measured("N1", "zero", error, 1e-6, "a.test_n1") for error in errors), {"a.test_n1": passed})


def test_a_line_says_whether_each_precision_passes():
    measured, excused = page_lines(ROWS, [run_of(True, 1e-8), run_of(False, 1e-2), run_of(True)])
    assert measured == ("N1", "it breaks", "zero", "1e-08", "1e-06", "yes", "**no**", "yes", "`a.test_n1`")
    assert excused == ("N2", "nothing to break", "does not apply: we have none", "", "", "", "", "", "")
    assert len(measured) == len(excused) == len(HEADER)


def test_a_test_that_did_not_run_in_a_precision_has_not_passed():
    assert page_lines(ROWS, [run_of(True, 0.0), RowsRun((), {})])[0][6] == "**no**"


def test_a_row_that_nobody_measures_is_refused():
    with pytest.raises(UserError, match="N1: no test measures it"):
        page_lines(ROWS, [run_of(True)])


def test_a_test_that_fails_without_measuring_is_named():
    with pytest.raises(UserError, match=r"a\.test_n1: failed before it measured anything"):
        page_lines(ROWS, [run_of(False)])


def test_every_row_of_the_repository_has_a_hazard():
    rows = read_rows(ROOT / "tests/numeric_rows")
    assert {"N01", "N139", "K01", "T01"} <= rows.keys()
    assert all(about.keys() <= {"hazard", "reason"} and about["hazard"] for about in rows.values())


@pytest.mark.parametrize(("precision", "seen"), [(None, "float32"), ("bfloat16", "bfloat16"), ("float16", "float16")])
def test_rows_run_under_the_autocast_asked_for(tmp_path, precision, seen):
    (tmp_path / "conftest.py").write_text((ROOT / "tests/conftest.py").read_text())
    (tmp_path / "test_a.py").write_text(
        "import torch\n"
        "def seen():\n    return str((torch.ones(2, 2) @ torch.ones(2, 2)).dtype)\n"
        f"def test_n01_products(numeric_row):\n    numeric_row('N01', seen(), float(seen() != 'torch.{seen}'))\n"
        "def test_no_row():\n    assert seen() == 'torch.float32'\n"
    )
    options = [] if precision is None else [f"--autocast={precision}"]
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", f"--junitxml={tmp_path}/tests.xml"]
    done = subprocess.run([*command, "-o", "junit_family=legacy", *options, "test_a.py"], cwd=tmp_path)
    run = read_run(tmp_path / "tests.xml")
    assert done.returncode == 0
    assert [(line.row, line.inputs) for line in run.lines] == [("N01", f"torch.{seen}")]
    assert len(run.passed) == 2 and all(run.passed.values())
