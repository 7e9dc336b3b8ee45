"""Single parts of a run measured by themselves, where a whole report would cost more than the training did.

runs/<name>/measures.json: {part: figures}. `beliefs` needs the PC-VAE alone, the others all three stages. `seconds` are
those of the training of the stage that the part judges, its start and loading left out.
"""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from carff.beliefs import reparameterise
from carff.config import CarffConfig
from carff.evaluate_beliefs import reconstruction_scores, svm_scores
from carff.evaluate_forecast import evaluate_forecast
from carff.evaluate_plans import decision_milliseconds, trial_decisions, trial_pictures
from carff.evaluate_probe import evaluate_probe
from carff.evaluation_data import EvaluationData, load_belief_data, load_evaluation_data
from carff.planning_metrics import planning_table
from hashnerf.command_line import nearest, set_threads
from hashnerf.errors import UserError
from hashnerf.random_state import seed_everything
from hashnerf.transforms_json import write_atomically

MEASURES, BELIEFS = "measures.json", "beliefs"


def measure_parts(config: CarffConfig, parts: Sequence[str], futures: int) -> Path:
    """Measures the named parts of a run and writes them to its folder; returns the file.

    `futures` is the number of sampled futures a decision. Raises UserError for an unknown part, for fewer than one
    future and for a run that lacks a stage.
    """
    known = (BELIEFS, *OF_WHOLE_RUNS)
    for part in parts:
        if part not in known:
            raise UserError(f"parts: {part!r} is none; {nearest(part, known)}")
    if futures < 1:
        raise UserError(f"futures is {futures}; give at least 1")
    set_threads(config.threads)
    seed_everything(config.seed)
    found = {BELIEFS: measure_beliefs(config)} if BELIEFS in parts else {}
    rest = [part for part in parts if part in OF_WHOLE_RUNS]
    if rest:
        evaluation = load_evaluation_data(config)
        found |= {part: OF_WHOLE_RUNS[part](evaluation, futures) for part in rest}
    path = config.folder / MEASURES
    write_atomically(path, json.dumps(found, indent=1, allow_nan=False).encode())
    return path


def measure_beliefs(config: CarffConfig) -> dict:
    """Returns how well latents name states (shares) and how well pictures come back (dB)."""
    evaluation, cost = load_belief_data(config)
    scores, _ = svm_scores(evaluation)
    samples = reparameterise(evaluation.views.belief, evaluation.generator(1))
    return scores | reconstruction_scores(evaluation, samples) | {"seconds": cost["seconds"]}


def measure_forecast(evaluation: EvaluationData, futures: int = 0) -> dict:
    """Returns the errors of branch probabilities (shares) and what the probe could not tell."""
    results = evaluate_forecast(evaluation).results["forecast"]
    kept = ("branch_ece", "branch_mae", "ambiguous_branch_error", "unknown_share")
    return {key: results.get(key) for key in kept} | {"seconds": evaluation.model.costs["mdn"]["seconds"]}


def measure_decisions(evaluation: EvaluationData, futures: int) -> dict:
    """Returns how often decisions from `futures` sampled futures are right, by rule, and the time of one (ms).

    Raises UserError where the data set hides and shows nothing to decide about.
    """
    pictures = trial_pictures(evaluation) if evaluation.table.hazard is not None else None
    if pictures is None or pictures.hazard.all() or not pictures.hazard.any():
        raise UserError(f"{evaluation.config.dataset}: has no pictures of both kinds, hazard and clear, to decide from")
    decisions = trial_decisions(evaluation, pictures, (futures,))
    found: dict = {}
    for row in planning_table(decisions, pictures.hazard.numpy()):
        if row.n is not None:
            found[row.rule] = {"hazard_success": row.hazard.share, "clear_success": row.clear.share}
            found[row.rule]["success"] = float(np.mean([row.hazard.share, row.clear.share]))
    views = evaluation.views.select(pictures.view)
    pixels = evaluation.data.images[views.frame]
    found["decision_ms"] = decision_milliseconds(evaluation.model, pixels, futures, evaluation.generator(10))
    return found | {"probe_accuracy": evaluate_probe(evaluation).results["probe"]["accuracy"]}


OF_WHOLE_RUNS: dict[str, Callable[[EvaluationData, int], dict]] = {
    "forecast": measure_forecast,
    "decisions": measure_decisions,
}
