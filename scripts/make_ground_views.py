"""Stage 2 of aerial2ground: what a car would see along its paths and beside them, from the reconstruction.

python scripts/make_ground_views.py --config configs/aerial2ground/fast.yaml
python scripts/make_ground_views.py --config configs/aerial2ground/fast.yaml --pictures drives   # for the baselines
"""

from dataclasses import dataclass

from rich.progress import Progress

from aerial2ground.config import PicturesConfig
from aerial2ground.stages import run_ground_views
from hashnerf.command_line import parse_config, run_main


@dataclass(frozen=True)
class ViewsConfig(PicturesConfig):
    """The pipeline's config, and what is looked at."""

    of_truth: bool = False
    """Take pictures of the embedded town itself in place of views of a field: what a perfect field would show."""


def main() -> None:
    """Render what is missing."""
    told = parse_config(ViewsConfig, description="Render ground views of a reconstructed town.")
    config = told.source
    with Progress(transient=True) as progress:
        task = progress.add_task("ground views")
        run_ground_views(config, lambda done, total: progress.update(task, completed=done, total=total), told.of_truth)
    print(f"{config.folder / 'ground'}: ground views are there")


if __name__ == "__main__":
    run_main(main)
