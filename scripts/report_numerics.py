"""Run the tests of the numbered rows and write docs/results/numerics.md: row, input, worst error, accepted, passed.

python scripts/report_numerics.py
"""

import json
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

from hashnerf.command_line import parse_config, read_yaml, run_main
from hashnerf.errors import UserError
from hashnerf.results_page import markdown_table
from hashnerf.run_info import commit, machine

HEADER = ("row", "hazard", "input", "worst error", "accepted", "passed", "test")


@dataclass(frozen=True)
class NumericsConfig:
    """Where the rows are listed and where the page goes."""

    rows: Path = Path("tests/numeric_rows")
    """Folder of YAML files with every row: what can go wrong, and why it does not apply where it does not."""
    page: Path = Path("docs/results/numerics.md")
    """The page to be written."""
    processes: int = 2
    """Tests that run at once."""


def measure(processes: int) -> list[tuple]:
    """Returns row, input, worst error, accepted error, whether its test passed, and the test."""
    with tempfile.TemporaryDirectory() as folder:
        options = ["-m", "numeric", "-n", str(processes), f"--junitxml={folder}/tests.xml", "-o", "junit_family=legacy"]
        if subprocess.run([sys.executable, "-m", "pytest", *options], check=False).returncode > 1:
            raise UserError("pytest could not run; run `python -m pytest -m numeric` to see why")
        return [line for case in ElementTree.parse(f"{folder}/tests.xml").iter("testcase") for line in lines_in(case)]


def lines_in(case: ElementTree.Element) -> list[tuple]:
    """Returns what one test measured; raises UserError for a test that failed before it measured anything."""
    test = f"{case.get('classname')}.{case.get('name')}"
    passed = case.find("failure") is None and case.find("error") is None
    found = [json.loads(entry.get("value")) for entry in case.iter("property") if entry.get("name") == "numeric_row"]
    if not passed and not found:
        raise UserError(f"{test}: failed before it measured anything; run `python -m pytest -m numeric` to see why")
    return [(*line, passed, test) for line in found]


def lines_of(row: str, about: dict, measured: list) -> list[tuple[str, ...]]:
    """Returns the table's lines of a row; raises UserError for one that is neither measured nor excused."""
    if "reason" in about:
        return [(row, about["hazard"], f"does not apply: {about['reason']}", "", "", "", "")]
    own = [line for line in measured if line[0] == row]
    if not own:
        raise UserError(f"{row}: no test measures it; write one with the fixture numeric_row, or give a reason")
    return [
        (row, about["hazard"], inputs, f"{worst:.2g}", f"{accepted:.2g}", "yes" if passed else "**no**", f"`{test}`")
        for _, inputs, worst, accepted, passed, test in own
    ]


def main() -> None:
    """Measure and write the page; exit code 1 where a row fails."""
    config = parse_config(NumericsConfig, description="Measure the numbered rows.")
    rows = {row: about for file in sorted(config.rows.glob("*.yaml")) for row, about in read_yaml(file).items()}
    measured = measure(config.processes)
    lines = [line for row, about in rows.items() for line in lines_of(row, about, measured)]
    about = f"`python scripts/report_numerics.py`; {machine()}; {commit()}."
    config.page.write_text(f"# Numbered rows\n\n{about}\n\n{markdown_table([HEADER, *lines])}\n", encoding="utf-8")
    failed = [line[0] for line in lines if line[5] == "**no**"]
    print(f"{config.page}: {len(rows)} rows, {len(measured)} measured, {len(failed)} failed {' '.join(failed)}")
    sys.exit(bool(failed))


if __name__ == "__main__":
    run_main(main)
