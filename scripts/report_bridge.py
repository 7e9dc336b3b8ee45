"""Run the tests of all requirements of the bridge and write docs/results/bridge.md, with what try_bridge.py measured.

python scripts/report_bridge.py
"""

import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

from aerial2ground.bridge.bridge_page import IMAGE, failed, page, read_parts, run_rows
from aerial2ground.bridge.try_parts import CHART
from hashnerf.command_line import parse_config, read_yaml, run_main
from hashnerf.run_info import commit, machine


@dataclass(frozen=True)
class BridgeReportConfig:
    """Where the requirements and figures are, and where the page goes."""

    rows: Path = Path("tests/bridge_rows.yaml")
    """The requirements."""
    results: Path = Path("runs/bridge_evidence")
    """What scripts/try_bridge.py and scripts/mutate_guard.py wrote."""
    page: Path = Path("docs/results/bridge.md")
    """The page to be written."""


def main() -> None:
    """Measure and write the page; exit code 1 where a requirement is not met."""
    config = parse_config(BridgeReportConfig, description="Measure the requirements of the bridge.")
    rows, parts = read_yaml(config.rows), read_parts(config.results)
    run = run_rows()
    about = (
        f"`python scripts/report_bridge.py` at {commit()}, {machine()}. No real motor controller was there: bytes are "
        "those that a fake one on a pseudo terminal received ([what is left for the operator](../deploy.md))."
    )
    shutil.copyfile(config.results / CHART, config.page.parents[1] / "images" / IMAGE)
    config.page.write_text(page(rows, run, parts, about), encoding="utf-8")
    wrong = failed(rows, run)
    print(f"{config.page}: {len(rows)} requirements, failed: {', '.join(wrong) or 'none'}")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    run_main(main)
