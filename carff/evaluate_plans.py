"""The planning part of the report: open-loop decisions from single pictures (CARFF Table 3), and how long one takes.

A *hazard* picture is one that hides its hazard (`carff.picture_kinds`); data in which nothing is hidden is tried on
pictures that show the danger, and says so. Pictures are the ego's own, of test cameras first, and no camera comes twice
before every one has come once; only where the ego has fewer than ten different ones do other cameras fill up. Every
trial draws its own n futures.
"""

import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Int
from torch import Tensor

from carff.charts import planning_chart
from carff.decisions import decide_from_pictures, sample_scenes
from carff.evaluate_probe import evidence_px
from carff.evaluation_data import EvaluationData, Part, Views
from carff.model import CarffModel
from carff.picture_kinds import picture_kinds
from carff.planner import decide
from carff.planning_metrics import PAPER_SUCCESS, plan_results, planning_table
from hashnerf.figure_style import png_bytes

RULES, SAMPLES = ("risk", "paper"), (2, 10, 35)
FEWEST_IMAGES = 10
_KINDS = ("hazard", "clear")
TIMED, WARM_UP, TIMED_SAMPLES = 24, 3, 10


@dataclass(frozen=True)
class TrialPictures:
    """Rows of the views that are planned from, which of them hide or show a hazard, and what there is to say."""

    view: Int[Tensor, " images"]
    hazard: Bool[Tensor, " images"]
    notes: tuple[str, ...]


def evaluate_plans(evaluation: EvaluationData) -> Part:
    """Returns the planning table, its chart and the time of a decision."""
    if evaluation.table.hazard is None:
        reason = "transforms.json does not say which states are hazards (`hazard` in `states`)"
        return Part({}, {}, {key: reason for key in ("plan", "decision_ms_n10")})
    pictures = trial_pictures(evaluation)
    if len(pictures.view) == 0:
        reason = "no picture is clearly a hazard or clearly safe: there is nothing to decide"
        return Part({}, {}, {key: reason for key in ("plan", "decision_ms_n10")})
    decisions = trial_decisions(evaluation, pictures)
    rows = planning_table(decisions, pictures.hazard.numpy())
    scenario = (evaluation.model.scene.world or {}).get("scenario", "")
    views = evaluation.views.select(pictures.view)
    images = {
        "hazard": int(pictures.hazard.sum()),
        "clear": int((~pictures.hazard).sum()),
        "hazard_test_cameras": int((pictures.hazard & views.test).sum()),
        "clear_test_cameras": int((~pictures.hazard & views.test).sum()),
        "trials": evaluation.config.evaluation.trials,
        "notes": list(pictures.notes),
    }
    images["notes"].insert(0, _counted(images))
    images["pictures"] = _picture_rows(evaluation, views, pictures, decisions["risk", 10])
    milliseconds = decision_milliseconds(
        evaluation.model, evaluation.data.images[views.frame], TIMED_SAMPLES, evaluation.generator(10)
    )
    results = {"plan": plan_results(rows), "plan_images": images, "decision_ms_n10": milliseconds}
    figures = {"planning": png_bytes(planning_chart(rows, PAPER_SUCCESS.get(scenario, {})))}
    return Part(results, figures, _reasons(pictures))


def trial_pictures(evaluation: EvaluationData) -> TrialPictures:
    """Chooses the pictures to plan from, `evaluation.images` of each kind as far as the ego has seen them."""
    wanted = evaluation.config.evaluation.images
    views, table = evaluation.views, evaluation.table
    kinds = picture_kinds(views.state, views.picture, table.known_hazard(), table.successor)
    notes = []
    if not kinds.hidden.any() and kinds.shown.any():
        notes.append("No picture hides a hazard here; the hazard pictures show it.")
    hazard = kinds.hidden if kinds.hidden.any() else kinds.shown
    rows = []
    for name, kind in zip(_KINDS, (hazard, kinds.clear)):
        generator = evaluation.generator(9)
        own = spread(views, kind & views.ego, wanted, generator)
        more = spread(views, kind & ~views.ego, max(min(wanted, FEWEST_IMAGES) - len(own), 0), generator)
        rows.append(torch.cat([own, more]))
        if len(more):
            notes.append(f"The ego's cameras give {len(own)} different {name} pictures; other cameras add {len(more)}.")
        if len(rows[-1]) < min(wanted, FEWEST_IMAGES):
            notes.append(f"The data has only {len(rows[-1])} different {name} pictures.")
    flags = torch.cat([torch.ones(len(rows[0]), dtype=torch.bool), torch.zeros(len(rows[1]), dtype=torch.bool)])
    return TrialPictures(torch.cat(rows), flags, tuple(notes))


def spread(views: Views, kind: Bool[Tensor, " n"], count: int, generator: torch.Generator) -> Int[Tensor, " k"]:
    """Draws up to `count` different pictures of a kind: test cameras first, each camera once before any comes again."""
    rows = kind.nonzero()[:, 0]
    rows = rows[torch.randperm(len(rows), generator=generator)]
    ranked, pictures, turns = [], set(), {}
    for row in rows.tolist():
        picture, camera = int(views.picture[row]), int(views.camera[row])
        if picture not in pictures:
            pictures.add(picture)
            turns[camera] = turns.get(camera, 0) + 1
            ranked.append((not bool(views.test[row]), turns[camera], len(ranked), row))
    return torch.tensor([row for *_, row in sorted(ranked)[:count]], dtype=torch.int64)


def trial_decisions(
    evaluation: EvaluationData, pictures: TrialPictures, samples: Sequence[int] = SAMPLES
) -> dict[tuple[str, int], Bool[np.ndarray, "images trials"]]:
    """Returns for every rule and number of samples whether each trial goes."""
    trials = evaluation.config.evaluation.trials
    belief = evaluation.views.belief.select(pictures.view.repeat_interleave(trials))
    decisions = {}
    for n in samples:
        future = sample_scenes(evaluation.model, belief, n, evaluation.generator(11)).future
        flags = evaluation.model.hazards(future.flatten(0, 1))
        hazard, unknown = (flag.reshape(-1, n) for flag in flags)
        for rule in RULES:
            planner = replace(evaluation.model.config.planner, rule=rule)
            go = [decide(own, unclear, planner).go for own, unclear in zip(hazard, unknown)]
            decisions[rule, n] = np.array(go).reshape(len(pictures.view), trials)
    return decisions


def decision_milliseconds(model: CarffModel, pictures: Tensor, n: int, generator: torch.Generator) -> float:
    """Returns the median wall-clock time of one decision from one picture, everything from encoding to the rule."""
    times = []
    for turn in range(WARM_UP + TIMED):
        picture = pictures[turn % len(pictures)][None]
        start = time.perf_counter()
        decide_from_pictures(model, picture, model.config.planner, n, generator)
        times.append(1000 * (time.perf_counter() - start))
    return statistics.median(times[WARM_UP:])


def _picture_rows(
    evaluation: EvaluationData, views: Views, pictures: TrialPictures, go: Bool[np.ndarray, "images trials"]
) -> list[dict]:
    """Returns what each picture was, and the share of its trials in which the risk rule at n = 10 was right."""
    evidence = evidence_px(evaluation, evaluation.table.known_hazard().long())[views.state, views.camera]
    right = np.where(pictures.hazard.numpy()[:, None], ~go, go).mean(axis=1)
    return [
        {
            "camera": int(views.camera[i]),
            "state": list(evaluation.table.states[int(views.state[i])]),
            "test": bool(views.test[i]),
            "kind": _KINDS[0] if pictures.hazard[i] else _KINDS[1],
            "evidence_px": int(evidence[i]),
            "success": float(right[i]),
        }
        for i in range(len(views))
    ]


def _counted(images: dict) -> str:
    kinds = (f"{images[kind]} {kind} pictures ({images[f'{kind}_test_cameras']} of test cameras)" for kind in _KINDS)
    return f"{' and '.join(kinds)}, {images['trials']} trials each."


def _reasons(pictures: TrialPictures) -> dict[str, str]:
    reasons = {}
    for side, flag in zip(_KINDS, (True, False)):
        if not (pictures.hazard == flag).any():
            sentence = f"the data has no {side} picture to decide from"
            reasons |= {f"plan.{rule}.n{n}.{side}_success": sentence for rule in RULES for n in SAMPLES}
            reasons |= {f"plan.{rule}.n35_change": sentence for rule in RULES}
    return reasons
