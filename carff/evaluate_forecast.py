"""The forecast part of the report: are sampled futures right, complete, and as probable as they should be?

Only views whose state goes on are asked for a forecast. Equal pictures give equal beliefs, so each distinct picture is
sampled once, `runs` times `draws` futures, and all its views share the answer. What may truly follow a picture is
whatever follows one of the states that give it; how often each branch does is the share of its states among them,
weighted by how often the branch happens.
Branch probabilities are shares of the samples whose branch the probe could tell, even where it could not tell the very
state; the rest is reported as unknown.
"""

import math
from dataclasses import asdict, dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from carff.beliefs import Belief, sample_beliefs
from carff.charts import accuracy_recall_chart, calibration_chart
from carff.decisions import sample_next_scores
from carff.evaluation_data import EvaluationData, Part, Views
from carff.forecast_metrics import AccuracyRecall, accuracy_recall_curves, branch_calibration, branch_frequency
from carff.probe import UNKNOWN
from hashnerf.figure_style import png_bytes

FEWEST_DRAWS = 100  # per picture, for branch probabilities


@dataclass(frozen=True)
class Pictures:
    """The distinct pictures among some views."""

    view: Int[Tensor, " pictures"]
    """One view of each picture."""
    of_view: Int[Tensor, " n"]
    """The picture of each view."""


def evaluate_forecast(evaluation: EvaluationData) -> Part:
    """Returns calibration of branch probabilities and the accuracy and recall curves."""
    draws = evaluation.config.evaluation.curve_samples
    runs = max(2, math.ceil(FEWEST_DRAWS / draws))
    views = evaluation.views.select(evaluation.goes_on())
    pictures = distinct_pictures(views)
    belief = views.belief.select(pictures.view)
    scores = sample_next_scores(evaluation.model, belief, runs * draws, evaluation.generator(6)).flatten(0, 1)
    states = evaluation.model.probe.classify(scores)
    votes = branch_votes(states, evaluation.model.probe.agreed(scores, evaluation.table.branch), evaluation)
    branches = votes.shape[1]
    of_pictures = votes.reshape(len(belief), -1, branches)
    results, figures, reasons = branch_results(evaluation, views, of_pictures[pictures.of_view])
    results["unknown_state_share"] = float((states == UNKNOWN).float().mean())

    results["components"] = component_use(evaluation, views, pictures)
    after = evaluation.table.successor[views.state]
    ahead = _curves(evaluation, views, pictures, after, states.reshape(len(belief), runs, draws))
    figures["accuracy_recall"] = png_bytes(accuracy_recall_chart(ahead, "Forecast"))
    everything = evaluation.views
    present = distinct_pictures(everything)
    now = _curves(evaluation, everything, present, everything.state, _present_states(evaluation, present, draws))
    figures["accuracy_recall_latents"] = png_bytes(accuracy_recall_chart(now, "Belief"))
    results |= {"accuracy_recall": asdict(ahead), "accuracy_recall_latents": asdict(now), "draws": runs * draws}
    return Part({"forecast": results}, figures, reasons)


@torch.no_grad()
def component_use(evaluation: EvaluationData, views: Views, pictures: Pictures) -> dict:
    """Returns how many components the mixture has, how many it uses, and how many the pictures ask for.

    A view's number is the exponential of an entropy: of the mixture's weights, and of the shares of the states that may
    truly follow its picture; means over views. `needed_most` is the largest number of such states.
    """
    weights = evaluation.model.mdn(*(getattr(views.belief, part) for part in ("mean", "logvar"))).log_weights.exp()
    table, same = evaluation.table, evaluation.same_boxes
    follows = torch.zeros(len(pictures.view), len(same), dtype=torch.float64)
    share = table.branch_weight[table.branch[views.state]].double()
    follows.index_put_((pictures.of_view, same[table.successor[views.state]]), share, accumulate=True)
    follows /= follows.sum(dim=1, keepdim=True)

    def mean_number(shares: Tensor) -> float:
        return float((-torch.xlogy(shares, shares).sum(dim=1)).exp().mean())

    return {
        "there": weights.shape[1],
        "used": mean_number(weights),
        "needed": mean_number(follows[pictures.of_view]),
        "needed_most": int((follows > 0).sum(dim=1).max()),
    }


def distinct_pictures(views: Views) -> Pictures:
    """Returns the distinct pictures among views."""
    numbers, of_view = views.picture.unique(return_inverse=True)
    first = torch.full((len(numbers),), len(views)).scatter_reduce(0, of_view, torch.arange(len(views)), "amin")
    return Pictures(first, of_view)


def branch_results(
    evaluation: EvaluationData, views: Views, votes: Float[Tensor, "n draws branches"]
) -> tuple[dict, dict[str, bytes], dict[str, str]]:
    """Returns calibration figures of all views, of each split and of the ego's cameras, its chart, reasons for gaps."""
    probability, answered = branch_probability(votes)
    branch = evaluation.table.branch[views.state]
    weight = evaluation.table.branch_weight.numpy()
    frequency = branch_frequency(views.picture.numpy(), branch.numpy(), weight)
    unknown = votes.sum(dim=-1) == 0
    results: dict = {
        "views": len(views),
        "views_without_answer": int((~answered).sum()),
        "unknown_share": float(unknown.float().mean()),
    }

    def calibration(kind: Bool[Tensor, " n"]) -> dict:
        use = (kind & answered).numpy()
        return branch_calibration(probability.numpy()[use], frequency[use], views.visibility.numpy()[use])

    everything = calibration(torch.ones(len(views), dtype=torch.bool))
    results |= {"branch_ece": everything["ece"], "branch_mae": everything.get("mae"), "calibration": everything}
    if everything["ece"] is None:
        reason = everything.get("reason", "the probe could not tell the branch of any sampled future")
        return results, {}, dict.fromkeys(_BRANCH_FIGURES, reason)
    for name, kind in (("train", views.train), ("test", views.test), ("ego", views.ego)):
        results[f"calibration_{name}"] = calibration(kind)
    ambiguous = torch.from_numpy(frequency.max(axis=1) < 1)
    results["ambiguous_branch_error"] = everything["ambiguous"]["error"]
    results["ambiguous_unknown_share"] = float(unknown[ambiguous].float().mean()) if ambiguous.any() else None
    reasons = {} if ambiguous.any() else {"forecast.ambiguous_branch_error": "no picture leaves the branch open"}
    return results, {"calibration": png_bytes(calibration_chart(everything))}, reasons


_BRANCH_FIGURES = ("forecast.branch_ece", "forecast.ambiguous_branch_error", "calibration")


def branch_votes(
    states: Int[Tensor, " n"], branch: Int[Tensor, " n"], evaluation: EvaluationData
) -> Float[Tensor, "n branches"]:
    """Returns what each sample says for each branch: a known state its branches evenly, else a known branch, else 0."""
    names = len(evaluation.table.branch_names)
    alone = torch.nn.functional.one_hot(branch.clamp(min=0), names).float() * (branch != UNKNOWN)[:, None]
    return torch.where((states != UNKNOWN)[:, None], evaluation.branch_share()[states.clamp(min=0)], alone)


def branch_probability(
    votes: Float[Tensor, "n draws branches"],
) -> tuple[Float[Tensor, "n branches"], Bool[Tensor, " n"]]:
    """Returns each branch's share of the samples that say anything, and which rows have any (the others are NaN)."""
    total = votes.double().sum(dim=1)
    return total / total.sum(dim=1, keepdim=True), total.sum(dim=1) > 0


def plausible_labels(
    of_view: Int[Tensor, " n"], label: Int[Tensor, " n"], pictures: int, labels: int
) -> Bool[Tensor, "pictures labels"]:
    """Returns which labels the views of each picture have."""
    plausible = torch.zeros(pictures, labels, dtype=torch.bool)
    plausible[of_view, label] = True
    return plausible


def _curves(
    evaluation: EvaluationData,
    views: Views,
    pictures: Pictures,
    truth: Int[Tensor, " n"],
    samples: Int[Tensor, "pictures runs draws"],
) -> AccuracyRecall:
    """Curves over the pictures of ego cameras; `truth` is the state that each view asks for."""
    same = evaluation.same_boxes
    plausible = plausible_labels(pictures.of_view, same[truth], len(pictures.view), len(same))
    ego = views.ego[pictures.view]
    return accuracy_recall_curves(samples[ego].numpy(), plausible[ego].numpy(), seed=evaluation.config.seed)


def _present_states(evaluation: EvaluationData, pictures: Pictures, draws: int) -> Int[Tensor, "pictures 1 draws"]:
    """Probed states of posterior samples; pictures of other cameras than the ego's are left unknown, as nobody asks."""
    ego = evaluation.views.ego[pictures.view]
    belief: Belief = evaluation.views.belief.select(pictures.view[ego])
    latents = sample_beliefs(belief, draws, evaluation.generator(7))
    states = torch.full((len(pictures.view), 1, draws), UNKNOWN)
    states[ego] = evaluation.model.probe_latents(latents.flatten(0, 1)).reshape(len(belief), 1, draws)
    return states
