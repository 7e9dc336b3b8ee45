"""Whether sampled futures are right, complete where the picture leaves several open, and as probable as they should be.

Notation: `samples` [i, r, n] are integer labels (of states or of branches; -1 = unknown) that belong to image i, run r,
draw n. Runs are independent repetitions of the same experiment; the figure "at n" uses the first n draws of a run.
`plausible` [i, k] marks the labels 0..k-1 that may truly follow image i: exactly one for a fully observed image,
several for an occluded one. Curves are indexed by n = 1..draws.

* accuracy(n): share of the n draws that are plausible (CARFF Fig. 8). Its expectation does not depend on n; only its
  scatter shrinks.
* all correct(n): share of runs whose n draws are ALL plausible. This is what a planner that trusts every draw feels,
  and it must fall.
* recall(n): share of the plausible labels that appear among the n draws (CARFF Fig. 8). It must rise.

Calibration compares the predicted probability of a branch with its true frequency. The truth of a view is not one
branch: it is the share of each branch among all states that give exactly this picture at this camera (0.5 where two
branches look the same). `branch_frequency` computes it.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from carff.intervals import bootstrap_band

VISIBILITY_CLASSES = ("none", "partial", "full")
BOOTSTRAPS = 1000


@dataclass(frozen=True)
class Curve:
    """A share in [0, 1] against n = 1..draws: mean, its 95 % bootstrap band, and what independent draws would give."""

    mean: Float[np.ndarray, " n"]
    low: Float[np.ndarray, " n"]
    high: Float[np.ndarray, " n"]
    closed_form: Float[np.ndarray, " n"]
    images: int


@dataclass(frozen=True)
class AccuracyRecall:
    """The curves of CARFF Fig. 8 and 13; None where no image is of the kind the curve needs."""

    accuracy: Curve | None
    all_correct: Curve | None
    """Both over images that determine their next label."""
    recall: Curve | None
    """Over images that leave several next labels open."""


def accuracy_recall_curves(
    samples: Int[np.ndarray, "images runs draws"],
    plausible: Bool[np.ndarray, "images labels"],
    bootstraps: int = BOOTSTRAPS,
    seed: int = 0,
) -> AccuracyRecall:
    """Accuracy, all-correct and recall curves for n = 1..draws from sampled labels (CARFF Fig. 8).

    A label outside 0..labels-1 is a wrong draw. The band resamples images with all their runs, the runs where there is
    one image only.
    """
    counts = plausible.sum(axis=1)
    if (counts == 0).any():
        raise ValueError(f"image {int((counts == 0).argmax())} has no plausible label")
    clear, open_ = counts == 1, counts > 1
    hits = _hits(samples, plausible)
    n = np.arange(1, samples.shape[2] + 1)

    def curve(kind: Bool[np.ndarray, " images"], values: np.ndarray, closed: np.ndarray) -> Curve | None:
        if not kind.any():
            return None
        low, high = _band(values[kind], bootstraps, seed)
        return Curve(values[kind].mean(axis=(0, 1)), low, high, closed[kind].mean(axis=0), int(kind.sum()))

    right = hits.mean(axis=(1, 2))[:, None]
    return AccuracyRecall(
        accuracy=curve(clear, hits.cumsum(axis=2) / n, np.broadcast_to(right, (len(hits), len(n)))),
        all_correct=curve(clear, np.minimum.accumulate(hits, axis=2).astype(np.float64), right**n),
        recall=curve(open_, _coverage(samples, plausible), _expected_coverage(samples, plausible, n)),
    )


def branch_frequency(
    picture: Int[np.ndarray, " v"], branch: Int[np.ndarray, " v"], weight: Float[np.ndarray, " branches"]
) -> Float[np.ndarray, "v branches"]:
    """The true frequency of every branch among the views that share a view's picture.

    `picture` holds one integer per distinct picture *of one camera*: equal pixels from two cameras are two pictures.
    A view counts by the weight of its branch.
    """
    _, picture = np.unique(picture, return_inverse=True)
    counts = np.zeros((picture.max(initial=-1) + 1, len(weight)))
    np.add.at(counts, (picture, branch), weight[branch].astype(np.float64))
    return (counts / counts.sum(axis=1, keepdims=True))[picture]


def branch_calibration(
    probability: Float[np.ndarray, "v branches"],
    frequency: Float[np.ndarray, "v branches"],
    visibility: Int[np.ndarray, " v"],
    bins: int = 10,
) -> dict:
    """Reliability of predicted branch probabilities overall, per visibility class (index into VISIBILITY_CLASSES) and
    on ambiguous views.

    `ece` is the expected calibration error: |mean probability - mean frequency| per probability bin, weighted by the
    bin's share; `mae` is the mean absolute error view by view, in which over- and underestimates cannot cancel. With a
    single branch every figure is None and `reason` says why.
    """
    if probability.shape[1] < 2:
        return {
            "ece": None,
            "views": len(probability),
            "reason": "the data has a single branch: there is nothing to be uncertain about",
        }
    if not (np.isfinite(probability).all() and np.allclose(probability.sum(axis=1), 1, atol=1e-3)):
        raise ValueError("each view's branch probabilities must be finite and sum to 1")
    ambiguous = frequency.max(axis=1) < 1
    result = _reliability(probability, frequency, bins)
    result["by_visibility"] = {
        name: _reliability(probability[visibility == index], frequency[visibility == index], bins)
        for index, name in enumerate(VISIBILITY_CLASSES)
    }
    result["ambiguous"] = _ambiguous(probability[ambiguous], frequency[ambiguous])
    return result


def _hits(samples: np.ndarray, plausible: np.ndarray) -> Bool[np.ndarray, "images runs draws"]:
    known = (samples >= 0) & (samples < plausible.shape[1])
    image = np.arange(len(samples))[:, None, None]
    return plausible[image, np.where(known, samples, 0)] & known


def _coverage(samples: np.ndarray, plausible: np.ndarray) -> Float[np.ndarray, "images runs draws"]:
    covered = np.zeros(samples.shape)
    for label in range(plausible.shape[1]):
        seen = np.maximum.accumulate(samples == label, axis=2)
        covered += seen & plausible[:, label, None, None]
    return covered / plausible.sum(axis=1)[:, None, None]


def _expected_coverage(samples: np.ndarray, plausible: np.ndarray, n: np.ndarray) -> Float[np.ndarray, "images draws"]:
    # One plausible label of probability p is missed by n independent draws with probability (1 - p)^n.
    p = np.stack([(samples == label).mean(axis=(1, 2)) for label in range(plausible.shape[1])], axis=1)
    found = (1 - (1 - p[:, :, None]) ** n) * plausible[:, :, None]
    return found.sum(axis=1) / plausible.sum(axis=1)[:, None]


def _band(values: Float[np.ndarray, "images runs draws"], bootstraps: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    # Images are the independent units (runs of one image share its belief); a single image leaves only its runs to
    # resample.
    curves = values.mean(axis=1) if len(values) > 1 else values[0]
    generator = torch.Generator().manual_seed(seed)
    low, high = bootstrap_band(torch.from_numpy(curves), resamples=bootstraps, generator=generator)
    return low.numpy(), high.numpy()


def _reliability(probability: np.ndarray, frequency: np.ndarray, bins: int) -> dict:
    predicted, true = probability.ravel(), frequency.ravel()
    which = np.minimum((predicted * bins).astype(int), bins - 1)
    rows = [
        {
            "low": index / bins,
            "high": (index + 1) / bins,
            "probability": float(predicted[which == index].mean()),
            "frequency": float(true[which == index].mean()),
            "count": int((which == index).sum()),
        }
        for index in np.unique(which)
    ]
    total = max(len(predicted), 1)
    empty = len(predicted) == 0
    return {
        "views": len(probability),
        "ece": None
        if empty
        else sum(row["count"] * abs(row["probability"] - row["frequency"]) for row in rows) / total,
        "mae": None if empty else float(np.abs(predicted - true).mean()),
        "bins": rows,
    }


def _ambiguous(probability: np.ndarray, frequency: np.ndarray) -> dict:
    if len(probability) == 0:
        return {"views": 0, "mean_probability": None, "mean_frequency": None, "error": None}
    mean, true = probability.mean(axis=0), frequency.mean(axis=0)
    return {
        "views": len(probability),
        "mean_probability": mean.tolist(),
        "mean_frequency": true.tolist(),
        "quantiles_probability": np.quantile(probability, [0.05, 0.25, 0.5, 0.75, 0.95], axis=0).T.tolist(),
        "error": float(np.abs(mean - true).max()),
    }
