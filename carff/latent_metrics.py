"""How well the means of encoded views separate the states of a scene (CARFF 4.2, D.1: SVM accuracy and t-SNE).

Notation: `latents` [n, d] holds one belief mean per view, `labels` [n] the state of that view as an integer, `correct`
[n] whether the classifier named it. Accuracies are shares in [0, 1]; the scores of subsets (actor visible, state
determined) come from the same cross-validated predictions through `subset_accuracy`, never from a classifier fitted to
the subset.

Two views with equal pixels but different states have the same latent. If one of them is in the training folds and the
other is judged, the classifier answers with the twin's label, which is wrong by construction: the score falls *below*
what the pixels allow. Pass `groups` (one integer per distinct picture) to keep such twins in one fold; then each pair
scores exactly one of two.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from sklearn.manifold import TSNE
from sklearn.model_selection import StratifiedGroupKFold, StratifiedKFold, cross_val_predict
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from carff.intervals import wilson_interval
from hashnerf.errors import UserError

SHUFFLE_SEED = 0
LARGEST_PERPLEXITY = 30.0
FEWEST_TSNE_POINTS = 4


@dataclass(frozen=True)
class SvmScore:
    """What a support vector machine made of the latents: a share in [0, 1] and the answer for every view."""

    accuracy: float
    correct: Bool[np.ndarray, " n"]
    predicted: Int[np.ndarray, " n"]
    folds: int
    """Folds really used; 0 where the machine was fitted on one set and judged on another."""
    classes: int
    chance: float
    """Accuracy of guessing uniformly among the classes."""
    majority: float
    """Accuracy of always answering the most frequent class of the judged views."""


def svm_accuracy(
    latents: Float[np.ndarray, "n d"],
    labels: Int[np.ndarray, " n"],
    groups: Int[np.ndarray, " n"] | None = None,
    folds: int = 10,
) -> SvmScore:
    """Cross-validated accuracy of an RBF machine with C = 1 on standardised latents (CARFF D.1, Table 5).

    Folds are stratified and shrink to the rarest class (or to the fewest groups). Raises UserError for latents that are
    not finite, for a single class and for a class with a single view.
    """
    latents = _checked(latents, "latents")
    classes, counts = _classes(labels)
    usable = min(folds, int(counts.min()))
    if groups is not None:
        usable = min(usable, *(len(np.unique(groups[labels == name])) for name in classes))
    if usable < 2:
        rarest = classes[counts.argmin()]
        raise UserError(
            f"class {rarest} has too few different views for cross-validation: give at least 2 views of every class"
        )
    splitter_class = StratifiedKFold if groups is None else StratifiedGroupKFold
    splitter = splitter_class(n_splits=usable, shuffle=True, random_state=SHUFFLE_SEED)
    predicted = cross_val_predict(_machine(), latents, labels, groups=groups, cv=splitter)
    return _score(predicted, labels, usable, len(classes))


def svm_heldout(
    train_latents: Float[np.ndarray, "n d"],
    train_labels: Int[np.ndarray, " n"],
    test_latents: Float[np.ndarray, "m d"],
    test_labels: Int[np.ndarray, " m"],
) -> SvmScore:
    """Accuracy on `test_latents` of the machine fitted on `train_latents` alone; labels never trained on are wrong."""
    train_latents, test_latents = _checked(train_latents, "training latents"), _checked(test_latents, "test latents")
    classes, _ = _classes(train_labels)
    predicted = _machine().fit(train_latents, train_labels).predict(test_latents)
    return _score(predicted, test_labels, 0, len(classes))


def subset_accuracy(correct: Bool[np.ndarray, " n"], mask: Bool[np.ndarray, " n"], confidence: float = 0.95) -> dict:
    """Share of `correct` among the views in `mask` with its Wilson interval; an empty mask gives None, not a number."""
    count, right = int(mask.sum()), int(correct[mask].sum())
    if count == 0:
        return {"accuracy": None, "count": 0, "interval": None}
    return {
        "accuracy": right / count,
        "count": count,
        "interval": [float(end) for end in wilson_interval(right, count, confidence)],
    }


def tsne_embedding(latents: Float[np.ndarray, "n d"], seed: int) -> Float[np.ndarray, "n 2"]:
    """The latents laid out in the plane by t-SNE (CARFF Fig. 11), the same for the same seed.

    Latents are centred but not standardised: a dimension that the encoder leaves unused must not be blown up to the
    size of the others. Raises UserError for fewer than four points.
    """
    latents = _checked(latents, "latents")
    if len(latents) < FEWEST_TSNE_POINTS:
        raise UserError(f"t-SNE needs at least {FEWEST_TSNE_POINTS} latents, got {len(latents)}")
    centred = latents - latents.mean(axis=0)
    if not centred.any():
        return np.zeros((len(latents), 2))
    perplexity = min(LARGEST_PERPLEXITY, (len(latents) - 1) / 3)
    start = "pca" if latents.shape[1] >= 2 else "random"
    layout = TSNE(perplexity=perplexity, init=start, random_state=seed, n_jobs=1, max_iter=750)
    return layout.fit_transform(centred / centred.std()).astype(np.float64)


def _machine() -> Pipeline:
    # The scaler sits inside the pipeline, so every fold is scaled by the statistics of its own training views.
    return make_pipeline(StandardScaler(), SVC(kernel="rbf", C=1.0, gamma="scale"))


def _checked(latents: Float[np.ndarray, "n d"], name: str) -> Float[np.ndarray, "n d"]:
    if len(latents) == 0:
        raise UserError(f"{name}: there are none; encode at least one view")
    if not np.isfinite(latents).all():
        rows = int((~np.isfinite(latents)).any(axis=1).sum())
        raise UserError(
            f"{name}: {rows} of {len(latents)} rows are not finite; the encoder has diverged, lower the learning rate"
        )
    # float64 keeps the squared distances of the kernel exact for latents far from the origin.
    return latents.astype(np.float64)


def _classes(labels: Int[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
    classes, counts = np.unique(labels, return_counts=True)
    if len(classes) < 2:
        raise UserError(f"every view has the label {classes[0]}: separability needs at least two states")
    return classes, counts


def _score(predicted: np.ndarray, labels: np.ndarray, folds: int, classes: int) -> SvmScore:
    correct = predicted == labels
    _, counts = np.unique(labels, return_counts=True)
    return SvmScore(
        accuracy=float(correct.mean()),
        correct=correct,
        predicted=predicted.astype(np.int64),
        folds=folds,
        classes=classes,
        chance=1.0 / classes,
        majority=float(counts.max() / counts.sum()),
    )
