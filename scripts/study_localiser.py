"""What a localiser needs: curves of its error against the number of views and the size of the network.

python scripts/study_localiser.py --config configs/aerial2ground/fast.yaml    # after make demo-aerial
"""

import sys
from dataclasses import dataclass
from pathlib import Path

from aerial2ground.config import AerialConfig
from aerial2ground.evaluation_stages import test_drives
from aerial2ground.localiser_study import Trainer, cases, prepare, smallest_that_can, study_chart, study_table, words
from hashnerf.command_line import parse_config, run_main, usable_cores
from hashnerf.figure_style import png_bytes
from hashnerf.run_info import commit, machine
from hashnerf.worker_processes import map_in_processes

TARGET = 0.3


@dataclass(frozen=True)
class StudyConfig(AerialConfig):
    """The pipeline's config, what is tried, and where the page goes."""

    page: str = "docs/results/localisation.md"
    """The page to be written, with a PNG of the same name beside it."""
    views_tried: tuple[int, ...] = (100, 200, 400, 1200)
    """Views per trajectory; those of the field end with what the run has."""
    filters_tried: tuple[int, ...] = (8, 16, 32)
    """Filters of every convolution."""


def main() -> None:
    """Train and try all networks, then write the page."""
    config = parse_config(StudyConfig, description="Measure what a localiser needs.")
    page = Path(config.page)
    page.parent.mkdir(parents=True, exist_ok=True)  # before hours of work
    tried = cases(config.views_tried, config.filters_tried, config.imitation.views)
    learn, elsewhere = prepare(config, config.views_tried)
    drives = test_drives(config)
    results = {}
    for case, errors in zip(
        tried, map_in_processes(Trainer(config, learn, elsewhere, drives), tried, config.workers or usable_cores())
    ):
        results[case] = errors
        print(f"{case.source} {case.views} views, {case.filters} filters: {errors.now_m:.2f} m", flush=True)
    paths = len(drives)
    able = {source: words(case, paths) for source, case in smallest_that_can(results, TARGET).items()}
    about = f"`python scripts/study_localiser.py {' '.join(sys.argv[1:])}`; one seed; {machine()}; {commit()}."
    page.with_suffix(".png").write_bytes(png_bytes(study_chart(results, paths, TARGET)))
    page.write_text(
        f"# What a localiser needs\n\n{about}\n\n{study_table(results, paths)}\n\n"
        f"Smallest that is within {TARGET} m in the town as it is now: from views of the field {able['field']}, "
        f"from true pictures {able['truth']}.\n\n![Errors]({page.with_suffix('.png').name})\n",
        encoding="utf-8",
    )


if __name__ == "__main__":
    run_main(main)
