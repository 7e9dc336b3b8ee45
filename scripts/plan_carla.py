"""Drive a trained run in closed loop: each policy decides again and again from what the ego's camera shows.

python scripts/plan_carla.py --run runs/intersection_fast
python scripts/plan_carla.py --config configs/carff/fast.yaml
python scripts/plan_carla.py --run runs/intersection_fast --world carla --host localhost --port 2000

`embedded` drives random episodes in the world that the data set was rendered from, decides from single pictures all
along the approach, and writes closed_loop.json into the run folder, where scripts/evaluate_carff.py finds it. `carla`
prints the decision for each picture of a camera in a CARLA server; this part could not be tried against a live server.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from carff.carla_client import CarlaConfig, watch
from carff.closed_loop import drive_run
from carff.config import CarffConfig
from carff.decision_budget import samples_within
from carff.driving import DrivingConfig
from carff.model import load_carff
from carff.planning_metrics import approach_results, closed_loop_results
from carff.report_tables import drive_tables
from hashnerf.command_line import parse_config, run_main, set_threads
from hashnerf.errors import UserError
from hashnerf.report_tables import text_lines


@dataclass(frozen=True)
class PlanConfig(CarffConfig):
    """The pipeline's config, and how to drive."""

    run: str = ""
    """Folder of a trained run; by default the one that name and runs give."""
    world: Literal["embedded", "carla"] = "embedded"
    """`embedded`: the world the data set comes from; `carla`: a running CARLA server."""
    samples: int = 10
    """Sampled futures per decision."""
    max_ms: float = 0.0
    """Takes as many futures as this many milliseconds a decision allow here, in place of `samples`; 0: no limit."""
    workers: int = 0
    """Processes that render; 0 uses all cores."""
    driving: DrivingConfig = field(default_factory=DrivingConfig)
    """How the ego drives, and how much episodes differ."""
    host: str = "localhost"
    """Host of the CARLA server."""
    port: int = 2000
    """Port of the CARLA server."""
    carla: CarlaConfig = field(default_factory=CarlaConfig)
    """The camera in the CARLA server."""

    def __post_init__(self):
        super().__post_init__()
        if self.samples < 1:
            raise UserError(f"samples is {self.samples}; give at least 1 sampled future per decision")


def main() -> None:
    """Drive and print what happened."""
    config = parse_config(PlanConfig, description="Drive a trained run in closed loop.")
    set_threads(config.threads)
    folder = Path(config.run) if config.run else config.folder
    samples = samples_within(load_carff(folder), config.max_ms) if config.max_ms else config.samples
    if config.world == "carla":
        decisions = watch(load_carff(folder), config.host, config.port, config.carla, samples, config.seed)
        for number, one in enumerate(decisions):
            print(f"{number:4d}  {'go' if one.go else 'stop':4s}  hazard probability {one.hazard_probability:.2f}")
        return
    episodes = config.evaluation.episodes
    driven = drive_run(folder, episodes, samples, config.driving, config.seed, config.workers)
    if driven.reason:
        print(f"not driven: {driven.reason}")
        return
    results = {"closed_loop": closed_loop_results(driven.episodes), "approach": approach_results(driven.approach)}
    for table in drive_tables(results):
        print("\n".join([*text_lines(table), ""]))


if __name__ == "__main__":
    run_main(main)
