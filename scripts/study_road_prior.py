"""What the road prior is worth: fields with parts of it, from fog and from an opaque ground, several seeds each.

python scripts/make_dataset.py --config configs/worlds/mini_city_avenue.yaml
python scripts/study_road_prior.py --config configs/aerial2ground/fast.yaml --dataset data/mini_city_avenue \
    --name prior_study --reconstruction.steps 400 --reconstruction.road_prior.start 0.35   # below the crowns
"""

import sys
from dataclasses import dataclass
from pathlib import Path

from aerial2ground.config import AerialConfig
from aerial2ground.prior_study import read_figures, study_tables, trials
from hashnerf.command_line import parse_config, run_main, usable_cores
from hashnerf.pipeline import run_stages_together
from hashnerf.run_info import commit, machine

SCRIPTS = Path(__file__).resolve().parent


@dataclass(frozen=True)
class StudyConfig(AerialConfig):
    """The pipeline's config, and where the tables go."""

    page: str = "docs/results/road_prior.md"
    """The page to be written."""
    intervals_of: int = 3
    """Seeds of every kind of field."""


def main() -> None:
    """Train and measure what is missing, then write the page."""
    arguments = sys.argv[1:]
    config = parse_config(StudyConfig, arguments, description="Measure what the road prior is worth.")
    study, cores = trials(config.intervals_of), usable_cores()
    own = [part for part in arguments if not part.startswith(("--page", "--intervals_of"))]

    def command(script: str, trial, *options: str) -> list[str]:
        place = ["--name", f"{config.name}/{trial.name}"]
        return [str(SCRIPTS / script), *own, *trial.options, *place, *options]

    fields = [(f"train {trial.name}", command("train_road_nerf.py", trial)) for trial in study]
    run_stages_together(fields, config.folder, cores, "fields")
    figures = [
        (f"measure {t.name}", command("evaluate_reconstruction.py", t, "--aerial", "false"))
        for t in study
        if not (config.folder / t.name / "reconstruction.json").is_file()
    ]
    run_stages_together(figures, config.folder, cores, "figures")
    tables = study_tables(read_figures(config.folder, study))
    steps = config.reconstruction.steps
    about = f"`python scripts/study_road_prior.py {' '.join(arguments)}`; {steps} steps; {machine()}; {commit()}."
    Path(config.page).write_text(f"# What the road prior is worth\n\n{about}\n\n{tables}", encoding="utf-8")
    print(tables)


if __name__ == "__main__":
    run_main(main)
