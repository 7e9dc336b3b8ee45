"""Write docs/results/aerial2ground.md from the reports of finished runs of aerial2ground.

python scripts/publish_aerial_results.py --runs '[runs/mini_city_fast, runs/mini_city_balanced]'
"""

from dataclasses import dataclass
from pathlib import Path

from aerial2ground.results_page import publish
from hashnerf.command_line import parse_config, run_main


@dataclass(frozen=True)
class PublishConfig:
    """Which runs to publish, and where."""

    runs: tuple[str, ...]
    """Run folders, in the order of the table's columns."""
    out: str = "docs/results"
    """Folder for the page and the copies of the reports."""


def main() -> None:
    """Write the page."""
    config = parse_config(PublishConfig, description="Write the results page from finished runs.")
    print(publish([Path(run) for run in config.runs], Path(config.out)))


if __name__ == "__main__":
    run_main(main)
