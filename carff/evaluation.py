"""The evaluation of a trained run: every figure of the report, measured in order, and the report itself.

The run and its data-set folder are all it reads; episodes driven in an embedded world come from the run folder.
"""

import time
from collections.abc import Callable
from pathlib import Path

from carff.config import CarffConfig
from carff.evaluate_beliefs import evaluate_beliefs
from carff.evaluate_costs import evaluate_closed_loop, evaluate_costs
from carff.evaluate_forecast import evaluate_forecast
from carff.evaluate_futures import evaluate_futures
from carff.evaluate_plans import evaluate_plans
from carff.evaluate_probe import evaluate_probe
from carff.evaluate_scenes import evaluate_scenes
from carff.evaluation_data import EvaluationData, Part, load_evaluation_data
from carff.report import write_report
from carff.run_info import describe_run
from hashnerf.command_line import set_threads
from hashnerf.random_state import seed_everything

PARTS: dict[str, Callable[[EvaluationData], Part]] = {
    "beliefs": evaluate_beliefs,
    "scenes": evaluate_scenes,
    "probe": evaluate_probe,
    "forecast": evaluate_forecast,
    "futures": evaluate_futures,
    "plans": evaluate_plans,
    "closed loop": evaluate_closed_loop,
}


def evaluate(
    config: CarffConfig, command: str = "", on_part: Callable[[str, float], None] = lambda name, seconds: None
) -> Path:
    """Measures everything and writes the report into the run folder; returns the path of report.html.

    `command` is what the report's header names; `on_part` is told each part's name and seconds. Raises UserError for a
    run that is not finished or that was trained on other data.
    """
    start = time.monotonic()
    set_threads(config.threads)
    seed_everything(config.seed)
    evaluation = load_evaluation_data(config)
    seconds = {"loading": time.monotonic() - start}
    on_part("loading", seconds["loading"])
    results: dict = {}
    figures: dict[str, bytes] = {}
    reasons: dict[str, str] = {}
    for name, measure in PARTS.items():
        began = time.monotonic()
        part = measure(evaluation)
        results |= part.results
        figures |= part.figures
        reasons |= part.not_run
        seconds[name] = time.monotonic() - began
        on_part(name, seconds[name])
    costs = evaluate_costs(evaluation, time.monotonic() - start)
    results |= {"evaluation_seconds": seconds} | costs.results
    world = evaluation.model.scene.world or {}
    run = describe_run(config, world.get("scenario", Path(config.dataset).name), command)
    return write_report(config.folder, run, results, figures | costs.figures, reasons)
