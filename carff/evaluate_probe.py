"""The probe part of the report: does the density of a scene tell the state that its latent stands for?

Judged on one posterior sample of every view whose picture settles which boxes are occupied: all states with that
picture have the same ones. Views of training and of test cameras count; the probe was calibrated on the former. An
answer is right when its boxes are the true ones, and *absent* is among the answers: a state without the actor is a
state whose boxes are empty. *Unknown* is never right.
"""

import numpy as np
import torch
from jaxtyping import Bool, Int
from torch import Tensor

from carff.beliefs import reparameterise
from carff.charts import confusion_heatmap
from carff.evaluation_data import EvaluationData, Part, one_label
from carff.figure_style import png_bytes
from carff.latent_metrics import subset_accuracy
from carff.probe import UNKNOWN


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
    results["unknown"] = float((answers == UNKNOWN).float().mean())
    distinct = same.unique()
    counts = confusion(truth, answers, distinct)
    names = [class_name(evaluation, same == state) for state in distinct.tolist()]
    results["confusion"] = {"truth": names, "answers": [*names, "unknown"], "counts": counts.tolist()}
    title = f"State read from the density, {len(views)} views"
    figure = confusion_heatmap(counts, names, [*names, "unknown"], title)
    return Part({"probe": results}, {"probe_confusion": png_bytes(figure)}, {})


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
