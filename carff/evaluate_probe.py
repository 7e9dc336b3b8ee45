"""The probe part of the report: does the density of a scene tell the state that its latent stands for?

Judged on one posterior sample of every view whose picture settles which boxes are occupied: all states with that
picture have the same ones. Views of training and of test cameras count; the probe was calibrated on the former. An
answer is right when its boxes are the true ones, and *absent* is among the answers: a state without the actor is a
state whose boxes are empty. *Unknown* is never right.
"""

import math
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Bool, Int
from torch import Tensor

from carff.beliefs import reparameterise
from carff.charts import confusion_heatmap
from carff.evaluation_data import EvaluationData, Part, one_label
from carff.latent_metrics import subset_accuracy
from carff.probe import UNKNOWN
from carff.scene_metrics import CHANGE_THRESHOLD
from hashnerf.figure_style import png_bytes

EVIDENCE = (0, 10, 30, 100, math.inf)  # pixels: a mirror, a car far away, a car, a car near by


def evaluate_probe(evaluation: EvaluationData) -> Part:
    """Returns the accuracy of the probe and its confusion matrix."""
    same = evaluation.same_boxes
    everything = evaluation.views
    views = everything.select(one_label(everything.picture, same[everything.state]))
    if len(views) == 0:
        reason = "no picture settles where the actors stand: there is nothing to compare the probe's answers with"
        return Part({}, {}, {"probe": reason, "probe_confusion": reason})
    answers = evaluation.model.probe_latents(reparameterise(views.belief, evaluation.generator(5)))
    truth = same[views.state]
    correct = (answers == truth).numpy()
    results: dict = {}
    for name, mask in (
        ("", np.ones(len(views), dtype=bool)),
        ("train_", views.train.numpy()),
        ("test_", views.test.numpy()),
    ):
        found = subset_accuracy(correct, mask)
        results |= {
            f"{name}accuracy": found["accuracy"],
            f"{name}interval": found["interval"],
            f"{name}views": found["count"],
        }
    evidence = evidence_px(evaluation, same)
    results["by_evidence"] = accuracy_by_evidence(correct, evidence[views.state, views.camera].numpy())
    results["unknown"] = float((answers == UNKNOWN).float().mean())
    distinct = same.unique()
    counts = confusion(truth, answers, distinct)
    names = [class_name(evaluation, same == state) for state in distinct.tolist()]
    results["confusion"] = {"truth": names, "answers": [*names, "unknown"], "counts": counts.tolist()}
    title = f"State read from the density, {len(views)} views"
    figure = confusion_heatmap(counts, names, [*names, "unknown"], title)
    return Part({"probe": results}, {"probe_confusion": png_bytes(figure)}, {})


def evidence_px(evaluation: EvaluationData, label: Int[Tensor, " states"]) -> Int[Tensor, "states cameras"]:
    """Returns in how many pixels each view differs from the most similar view of a state with another label.

    Compared are the views of one camera; pixels count from `CHANGE_THRESHOLD` on, as in the pictures' figures. A view
    without such another view has all its pixels.
    """
    views, images = evaluation.table.views, evaluation.data.images
    evidence = torch.full(views.shape, images.shape[1] * images.shape[2])
    for camera in range(views.shape[1]):
        states = (views[:, camera] >= 0).nonzero()[:, 0]
        pictures = images[views[states, camera]].short()
        for state, picture in zip(states.tolist(), pictures):
            changed = ((pictures - picture).abs().amax(dim=-1) > CHANGE_THRESHOLD * 255).sum(dim=(1, 2))
            others = changed[label[states] != label[state]]
            if len(others):
                evidence[state, camera] = others.min()
    return evidence


def accuracy_by_evidence(correct: Bool[np.ndarray, " n"], evidence: Int[np.ndarray, " n"]) -> list[dict]:
    """Returns accuracy and number of views for each class of `EVIDENCE`."""
    rows = []
    for low, high in pairwise(EVIDENCE):
        inside = (evidence >= low) & (evidence < high)
        found = subset_accuracy(correct, inside)
        top = None if math.isinf(high) else high
        rows.append({"low": low, "high": top, "views": int(inside.sum()), "accuracy": found["accuracy"]})
    return rows


def confusion(
    truth: Int[Tensor, " n"], answers: Int[Tensor, " n"], distinct: Int[Tensor, " k"]
) -> Int[np.ndarray, "k answers"]:
    """Counts answers (columns: the distinct states, then unknown) for each true state (rows)."""
    row = torch.searchsorted(distinct, truth)
    column = torch.where(answers == UNKNOWN, len(distinct), torch.searchsorted(distinct, answers.clamp(min=0)))
    counts = torch.zeros(len(distinct), len(distinct) + 1, dtype=torch.int64)
    counts.index_put_((row, column), torch.ones_like(row), accumulate=True)
    return counts.numpy()


def class_name(evaluation: EvaluationData, members: Bool[Tensor, " states"]) -> str:
    """Returns the names of the states that share their boxes, joined."""
    return " = ".join(evaluation.style.names[state] for state in members.nonzero()[:, 0].tolist())
