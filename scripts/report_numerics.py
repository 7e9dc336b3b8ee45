"""Run the tests of the numbered rows in float32 and under half-precision autocast; write docs/results/numerics.md.

python scripts/report_numerics.py
"""

import sys
from dataclasses import dataclass
from pathlib import Path

from hashnerf.command_line import parse_config, run_main
from hashnerf.numeric_rows import HEADER, PRECISIONS, page_lines, read_rows, run_rows
from hashnerf.results_page import markdown_table
from hashnerf.run_info import commit, machine


@dataclass(frozen=True)
class NumericsConfig:
    """Where the rows are listed and where the page goes."""

    rows: Path = Path("tests/numeric_rows")
    """Folder of YAML files with every row: what can go wrong, and why it does not apply where it does not."""
    page: Path = Path("docs/results/numerics.md")
    """The page to be written."""
    processes: int = 2
    """Tests that run at once."""


def main() -> None:
    """Measure and write the page; exit code 1 where a row fails in any precision."""
    config = parse_config(NumericsConfig, description="Measure the numbered rows.")
    rows = read_rows(config.rows)
    lines = page_lines(rows, [run_rows(precision, config.processes) for precision in PRECISIONS])
    about = (
        f"`python scripts/report_numerics.py`; {machine()}; {commit()}. Errors are those in float32; the same tests, "
        "with the same errors accepted, also run under a bfloat16 and a float16 autocast."
    )
    config.page.write_text(f"# Numbered rows\n\n{about}\n\n{markdown_table([HEADER, *lines])}\n", encoding="utf-8")
    failed = [line[0] for line in lines if "**no**" in line]
    print(f"{config.page}: {len(rows)} rows, {len(lines)} lines, {len(failed)} failed {' '.join(failed)}")
    sys.exit(bool(failed))


if __name__ == "__main__":
    run_main(main)
