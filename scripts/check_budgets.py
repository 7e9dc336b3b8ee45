"""Whether budgets are kept: trainings of a static scene within seconds, decisions of a CARFF run within milliseconds.

python scripts/check_budgets.py --dataset data/one_box --run runs/intersection_fast
"""

import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from carff.decision_budget import decision_p95_ms, samples_within
from carff.model import CarffModel, load_carff
from hashnerf.budget import Trial, write_trials
from hashnerf.command_line import parse_config, read_yaml, run_main, set_threads
from hashnerf.errors import UserError
from hashnerf.pipeline import run_stage
from hashnerf.run_info import commit, machine
from hashnerf.transforms_json import read_transforms

RUNS, TRAIN = Path("runs/budgets"), "scripts/train_static_nerf.py"


@dataclass(frozen=True)
class BudgetsConfig:
    """What is tried, and how often."""

    dataset: str = "data/one_box"
    """Pictures of a still scene."""
    run: str = ""
    """Folder of a trained CARFF run; empty leaves decisions out."""
    seconds: tuple[float, ...] = (20.0, 80.0, 320.0)
    """Budgets of a training."""
    milliseconds: tuple[float, ...] = (20.0, 40.0, 120.0)
    """Budgets of a decision."""
    repeats: int = 5
    """Trials of every budget."""
    batch_samples: int = 4096
    """Samples of a training step; few, so that trials are short."""

    def __post_init__(self) -> None:
        for key in ("seconds", "milliseconds", "repeats"):
            if not min(np.ravel(getattr(self, key)), default=0) > 0:
                raise UserError(f"{key} is {getattr(self, key)}; give what is positive")


def trainings(config: BudgetsConfig) -> Iterator[Trial]:
    """Train within every budget."""
    for budget in config.seconds:
        for number in range(config.repeats):
            name = f"within_{budget:g}_{number}"
            place = ["--dataset", config.dataset, "--runs", str(RUNS), "--name", name, "--overwrite", "true"]
            limits = ["--max_seconds", budget, "--threads", 1, "--fit.batch_samples", config.batch_samples]
            run_stage(f"{budget:g} s, trial {number + 1}", [TRAIN, *place, *map(str, limits)], RUNS)
            steps = read_yaml(RUNS / name / "config.yaml")["steps"]
            yield Trial(budget, f"{steps} steps", read_transforms(RUNS / name / "reconstruction.json")["seconds"])


def decisions(model: CarffModel, config: BudgetsConfig) -> Iterator[Trial]:
    """Choose within every budget and time what was chosen anew."""
    for budget in config.milliseconds * config.repeats:
        samples = samples_within(model, budget)
        yield Trial(budget, f"{samples} futures", decision_p95_ms(model, samples))


def main() -> None:
    """Try and write the page."""
    config = parse_config(BudgetsConfig, description="Check that budgets are kept.")
    set_threads(1)
    decided = decisions(load_carff(Path(config.run)), config) if config.run else []
    parts = {"Decisions, 95 % (`plan_carla.py --max_ms`)": ("ms", decided)}
    parts["Trainings (`train_static_nerf.py --max_seconds`)"] = ("s", trainings(config))
    about = f"`{shlex.join(['python', 'scripts/check_budgets.py', *sys.argv[1:]])}`; {machine()}; {commit()}."
    write_trials(parts, Path("docs/results/budgets.md"), about)


if __name__ == "__main__":
    run_main(main)
