"""Whether budgets are kept: trainings of a static scene within seconds, decisions of a CARFF run within milliseconds.

python scripts/check_budgets.py --dataset data/one_box --run runs/intersection_fast
"""

import shlex
import sys
from dataclasses import dataclass
from pathlib import Path

from carff.decision_budget import decision_p95_ms, samples_within
from carff.model import load_carff
from hashnerf.budget import Trial, trials_table
from hashnerf.command_line import parse_config, read_yaml, run_main, set_threads
from hashnerf.pipeline import run_stage
from hashnerf.results_page import table_lines
from hashnerf.run_info import commit, machine
from hashnerf.transforms_json import read_transforms

RUNS, TRAIN = Path("runs/budgets"), "scripts/train_static_nerf.py"


@dataclass(frozen=True)
class BudgetsConfig:
    """What is tried, and how often."""

    dataset: str = "data/one_box"
    """Pictures of the static scene."""
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


def trainings(config: BudgetsConfig) -> list[Trial]:
    """Train within every budget."""
    trials = []
    for budget in config.seconds:
        for number in range(config.repeats):
            name = f"within_{budget:g}_{number}"
            place = ["--dataset", config.dataset, "--runs", str(RUNS), "--name", name, "--overwrite", "true"]
            limits = ["--max_seconds", str(budget), "--threads", "1"]
            samples = ["--fit.batch_samples", str(config.batch_samples)]
            run_stage(f"{budget:g} s, trial {number + 1}", [TRAIN, *place, *limits, *samples], RUNS)
            steps = read_yaml(RUNS / name / "config.yaml")["steps"]
            taken = read_transforms(RUNS / name / "reconstruction.json")["seconds"]
            trials.append(Trial(budget, f"{steps} steps", taken))
    return trials


def decisions(config: BudgetsConfig) -> list[Trial]:
    """Choose within every budget and time what was chosen anew."""
    model, trials = load_carff(Path(config.run)), []
    for budget in config.milliseconds * config.repeats:
        samples = samples_within(model, budget)
        trials.append(Trial(budget, f"{samples} futures", decision_p95_ms(model, samples)))
    return trials


def main() -> None:
    """Try and write the page."""
    config = parse_config(BudgetsConfig, description="Check that budgets are kept.")
    set_threads(1)
    about = f"`{shlex.join(['python', 'scripts/check_budgets.py', *sys.argv[1:]])}`; {machine()}; {commit()}."
    lines = ["# Whether budgets are kept", "", about, "", "## Trainings (`train_static_nerf.py --max_seconds`)", ""]
    lines += table_lines(trials_table(trainings(config), "s"))
    if config.run:
        lines += ["", "## Decisions, 95 % of them (`plan_carla.py --max_ms`)", ""]
        lines += table_lines(trials_table(decisions(config), "ms"))
    Path("docs/results/budgets.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    run_main(main)
