"""Take one guard at a time out of a copy of the code, run the rows' tests that should notice, and write the page.

python scripts/plant_faults.py
"""

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from hashnerf.command_line import parse_config, run_main
from hashnerf.planted_faults import HEADER, FaultyCopy, fault_line, read_faults
from hashnerf.results_page import markdown_table
from hashnerf.run_info import commit, machine

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class FaultsConfig:
    """Where the faults are listed and where the page goes."""

    faults: Path = Path("tests/planted_faults.yaml")
    """YAML file of the faults: kernel, fault, file, old and new text, tests that should notice."""
    page: Path = Path("docs/results/planted_faults.md")
    """The page to be written."""


def main() -> None:
    """Plant every fault and write the page; exit code 1 where one goes unnoticed."""
    config = parse_config(FaultsConfig, description="Plant faults and see whether the tests notice.")
    lines = []
    with tempfile.TemporaryDirectory() as folder:
        copy = FaultyCopy(ROOT, Path(folder))
        for fault in read_faults(config.faults):
            lines.append(fault_line(fault, copy.failures(fault)))
            print(f"{fault.name}: {'caught' if lines[-1][3] == 'yes' else 'NOT caught'}", flush=True)
    about = f"`python scripts/plant_faults.py`; {machine()}; {commit()}."
    config.page.write_text(f"# Planted faults\n\n{about}\n\n{markdown_table([HEADER, *lines])}\n", encoding="utf-8")
    missed = sum(line[3] != "yes" for line in lines)
    print(f"{config.page}: {len(lines)} faults, {missed} not caught")
    sys.exit(bool(missed))


if __name__ == "__main__":
    run_main(main)
