"""The last parts of the report: driving in closed loop, as recorded in the run folder, and what every stage cost.

Seconds are wall clock, memory is the largest resident size of a stage's process in MB.
"""

from carff.approach_chart import approach_chart
from carff.charts import closed_loop_chart
from carff.closed_loop_file import load_closed_loop
from carff.evaluation_data import EvaluationData, Part
from carff.model import load_nerf
from carff.planning_metrics import approach_results, closed_loop_results
from hashnerf.figure_style import png_bytes
from hashnerf.pipeline import read_timings, total_seconds
from hashnerf.stage_costs import peak_memory_mb, stages_chart
from hashnerf.targets import WHOLE_RUN

EVALUATION = "evaluation"
TRAINED = {"PC-VAE", "radiance field", "forecast"}
TRAININGS = "trainings and evaluation only"


def evaluate_closed_loop(evaluation: EvaluationData) -> Part:
    """Returns the recorded episodes of every policy side by side."""
    if evaluation.model.scene.world is None:
        reason = "the data set was not rendered from an embedded world, so there is nothing to drive in"
        return Part({}, {}, dict.fromkeys(("closed_loop", "approach"), reason))
    recorded = load_closed_loop(evaluation.config.folder)
    if not recorded.episodes:
        return Part({}, {}, dict.fromkeys(("closed_loop", "approach"), recorded.reason or "no episode was driven"))
    policies = closed_loop_results(recorded.episodes)
    approach = approach_results(recorded.approach)
    figures = {
        "closed_loop": png_bytes(closed_loop_chart(policies)),
        "approach": png_bytes(approach_chart(approach["points"], evaluation.style, evaluation.table.states)),
    }
    kinds = ("hidden", "clear")
    reasons = {f"approach.{kind}": f"no picture is {kind}" for kind in kinds if not approach[kind]["pictures"]}
    if policies.get("risk", {}).get("needless_stop_rate", 0.0) is None:
        reasons["closed_loop.risk.needless_stop_rate"] = "every episode met another actor; drive more episodes"
    results = {"closed_loop": policies, "approach": approach, "closed_loop_settings": recorded.about}
    return Part(results, figures, reasons)


def evaluate_costs(evaluation: EvaluationData, own_seconds: float) -> Part:
    """Returns time and memory of every stage; this evaluation has taken `own_seconds` so far.

    Stages that scripts/demo.py timed as whole processes count with those times. A run some of whose trainings were
    called one by one counts the cost of the trainings: `seconds_cover` then says that data set and driving are not in
    the total.
    """
    timed = read_timings(evaluation.config.folder)
    timed.pop(EVALUATION, None)  # an earlier one
    cover = WHOLE_RUN if timed.keys() >= TRAINED else TRAININGS
    if cover == TRAININGS:
        timed = trained_stages(evaluation)
    timed[EVALUATION] = {"seconds": own_seconds, "peak_memory_mb": peak_memory_mb()}
    stages = [{"name": name, **cost} for name, cost in timed.items()]
    total = total_seconds(timed)
    results = {"stages": stages, "seconds_total": total, "seconds_cover": cover}
    return Part(results, {"stages": png_bytes(stages_chart(stages))})


def trained_stages(evaluation: EvaluationData) -> dict[str, dict]:
    """Returns the cost of training each stage, as the run's models record it."""
    costs = evaluation.model.costs
    stages = {"PC-VAE": costs["pcvae"]}
    if (evaluation.config.folder / "nerf_birds_eye").is_dir():
        _, held_out = load_nerf(evaluation.model.config, evaluation.model.scene, held_out=True)
        stages |= {"radiance field": held_out, "radiance field, with bird's-eye camera": costs["nerf"]}
    else:
        stages["radiance field"] = costs["nerf"]
    return stages | {"forecast": costs["mdn"]}
