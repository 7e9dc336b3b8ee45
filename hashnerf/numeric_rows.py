"""The numbered rows: which there are, what their tests measure, and whether they pass in each precision.

A row is a hazard with a number, listed in a YAML file, and either measured by tests (the fixture `numeric_row`) or
excused with a reason. Its tests run three times: as they are, and under a bfloat16 and a float16 autocast, where all
that must stay float32 shall stay so.
"""

import json
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from hashnerf.command_line import read_yaml
from hashnerf.errors import UserError

PRECISIONS = ("float32", "bfloat16", "float16")
"""The first is that of the code itself, the others those of an autocast around it."""
HEADER = ("row", "hazard", "input", "worst error", "accepted", *(f"passed, {name}" for name in PRECISIONS), "test")
LOOK = "run `python -m pytest -m numeric` to see why"


@dataclass(frozen=True)
class Measured:
    """One call of `numeric_row`."""

    row: str
    inputs: str
    worst: float
    accepted: float
    test: str
    unit: str = ""


@dataclass(frozen=True)
class RowsRun:
    """What one run of all rows' tests gave."""

    lines: tuple[Measured, ...]
    passed: Mapping[str, bool]
    """Whether each test passed, by its name."""


def read_rows(folder: Path) -> dict[str, dict]:
    """Returns what the folder's YAML files say of every row: its hazard, and a reason where it does not apply."""
    return {row: about for file in sorted(folder.glob("*.yaml")) for row, about in read_yaml(file).items()}


def run_rows(precision: str, processes: int) -> RowsRun:
    """Runs every row's tests in a precision of PRECISIONS; raises UserError where pytest itself fails."""
    with tempfile.TemporaryDirectory() as folder:
        options = ["-m", "numeric", "-n", str(processes), f"--junitxml={folder}/tests.xml", "-o", "junit_family=legacy"]
        if precision != PRECISIONS[0]:
            options.append(f"--autocast={precision}")
        if subprocess.run([sys.executable, "-m", "pytest", *options], check=False).returncode > 1:
            raise UserError(f"pytest could not run the rows in {precision}; {LOOK}")
        return read_run(Path(folder) / "tests.xml")


def read_run(report: Path, fixture: str = "numeric_row") -> RowsRun:
    """Returns what a JUnit report of pytest holds of rows that were measured with a fixture."""
    lines: list[Measured] = []
    passed = {}
    for case in ElementTree.parse(report).iter("testcase"):
        test = f"{case.get('classname')}.{case.get('name')}"
        passed[test] = case.find("failure") is None and case.find("error") is None
        for entry in case.iter("property"):
            if entry.get("name") == fixture:
                row, inputs, worst, accepted, *unit = json.loads(entry.get("value"))
                lines.append(Measured(row, inputs, worst, accepted, test, *unit))
    return RowsRun(tuple(lines), passed)


def page_lines(rows: Mapping[str, dict], runs: Sequence[RowsRun]) -> list[tuple[str, ...]]:
    """Returns the lines of the page's table below its HEADER, the errors from the first of the runs in PRECISIONS.

    Raises UserError for a row that is neither measured nor excused, and for a test that failed without measuring.
    """
    silent = sorted({test for test, passed in runs[0].passed.items() if not passed} - {m.test for m in runs[0].lines})
    if silent:
        raise UserError(f"{silent[0]}: failed before it measured anything; {LOOK}")
    return [line for row, about in rows.items() for line in _lines_of(row, about, runs)]


def _lines_of(row: str, about: Mapping, runs: Sequence[RowsRun]) -> list[tuple[str, ...]]:
    if "reason" in about:
        return [(row, about["hazard"], f"does not apply: {about['reason']}", *[""] * (len(HEADER) - 3))]
    own = [line for line in runs[0].lines if line.row == row]
    if not own:
        raise UserError(f"{row}: no test measures it; write one with the fixture numeric_row, or give a reason")
    return [
        (
            *(row, about["hazard"], line.inputs, f"{line.worst:.2g}", f"{line.accepted:.2g}"),
            *("yes" if run.passed.get(line.test) else "**no**" for run in runs),
            f"`{line.test}`",
        )
        for line in own
    ]
