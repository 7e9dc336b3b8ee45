import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.metrics.pairwise import rbf_kernel
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from carff.latent_metrics import subset_accuracy, svm_accuracy, svm_heldout, tsne_embedding
from hashnerf.errors import UserError
from tests.hashnerf.refusals import refuses


def _clusters(per_class: int, classes: int, spread: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    centres = rng.normal(size=(classes, 8)) * 4
    labels = np.repeat(np.arange(classes), per_class)
    return centres[labels] + spread * rng.normal(size=(len(labels), 8)), labels


def test_well_separated_states_are_all_named():
    score = svm_accuracy(*_clusters(20, 6, 0.1))
    assert score.accuracy == 1.0 and score.correct.all()
    assert score.folds == 10 and score.classes == 6
    assert score.chance == pytest.approx(1 / 6) and score.majority == pytest.approx(1 / 6)


def test_n78_random_labels_score_at_chance(numeric_row):
    rng = np.random.default_rng(1)
    labels = np.repeat(np.arange(4), 100)
    score = svm_accuracy(rng.normal(size=(400, 8)), labels)
    # Binomial standard deviation at chance 1/4 with 400 views: sqrt(0.25 * 0.75 / 400) = 0.0217.
    numeric_row("N78", "400 views, 4 random labels: accuracy from 1/4", abs(score.accuracy - 0.25), 4 * 0.0217)


def test_n78_twin_views_fall_below_their_ceiling_unless_twins_share_a_fold(numeric_row):
    # 60 pictures, each seen in both states: nobody can do better than one of two, and keeping twins together gives just
    # that.
    latents = np.repeat(np.random.default_rng(2).normal(size=(60, 8)) * 3, 2, axis=0)
    labels, picture = np.tile([0, 1], 60), np.repeat(np.arange(60), 2)
    assert svm_accuracy(latents, labels).accuracy < 0.3
    worst = abs(svm_accuracy(latents, labels, groups=picture).accuracy - 0.5)
    numeric_row("N78", "60 pictures under two labels each, kept together: accuracy from 1/2", worst)


def test_n78_scaling_and_a_far_origin_change_nothing(numeric_row):
    latents, labels = _clusters(20, 3, 5.0)
    plain = svm_accuracy(latents, labels)
    stretched = latents * np.logspace(-6, 6, 8) + 1e3
    assert 0.5 < plain.accuracy < 1.0
    changed = (svm_accuracy(stretched, labels).predicted != plain.predicted).mean()
    numeric_row("N78", "scales 1e-6 to 1e6, 1e3 from the origin: share of answers that change", changed, 0.0199)


def test_n78_float32_latents_far_from_the_origin_stay_separable(numeric_row):
    latents, labels = _clusters(20, 3, 0.1)
    wrong = ~svm_accuracy((latents + 1e3).astype(np.float32), labels).correct
    numeric_row("N78", "clusters 1e3 from the origin, float32: views misnamed", wrong.sum())


@pytest.mark.parametrize("origin", [0.0, 1e3, 1e6])
def test_n78_the_kernel_is_one_of_similarities(origin, numeric_row, monkeypatch):
    kernels = []

    class Watched(SVC):
        def fit(self, inputs, labels):
            kernels.append((inputs.dtype, rbf_kernel(inputs, gamma=1 / (inputs.shape[1] * inputs.var()))))
            return super().fit(inputs, labels)

    monkeypatch.setattr("carff.latent_metrics.SVC", Watched)
    latents, labels = _clusters(20, 3, 1.0)
    svm_accuracy((latents + origin).astype(np.float32), labels, folds=2)
    assert len(kernels) == 2 and all(dtype == np.float64 for dtype, _ in kernels)
    outside = np.max([np.abs(kernel - kernel.clip(0, 1)) for _, kernel in kernels])
    numeric_row("N78", f"clusters {origin:g} from the origin: kernel outside [0, 1] by", outside)
    apart = np.max([np.abs(kernel - kernel.T) for _, kernel in kernels])
    numeric_row("N78", f"clusters {origin:g} from the origin: kernel less its transpose", apart, 1e-15)
    lowest = np.min([np.linalg.eigvalsh(kernel) for _, kernel in kernels])
    numeric_row("N78", f"clusters {origin:g} from the origin: least eigenvalue below 0 by", max(-lowest, 0.0), 1e-6)


def test_n78_constant_latents_give_a_finite_accuracy_no_better_than_the_majority(numeric_row):
    score = svm_accuracy(np.full((40, 8), 3.7), np.repeat([0, 1], 20))
    worst = score.accuracy - 0.5 if score.accuracy >= 0 else np.inf
    numeric_row("N78", "constant latents, two states: accuracy above 1/2", worst, 1e-9)


def test_n78_a_held_out_fold_never_scales_the_training_folds(numeric_row):
    # The first feature carries the class, the second is noise; one view lies 1e6 away in the first. Scaled with it, the
    # first feature vanishes beside the noise; scaled without it (in the fold that holds it out), the classes stay
    # apart. Of 2 folds exactly one is spoilt: about half of its views are named by luck, 3 of 4 in all.
    rng = np.random.default_rng(3)
    labels = np.tile([0, 1], 40)
    latents = np.stack([labels * 4.0 + 0.1 * rng.normal(size=80), rng.normal(size=80)], axis=1)
    latents[1, 0] = 1e6
    accuracy = svm_accuracy(latents, labels, folds=2).accuracy
    numeric_row("N78", "an outlier in one of two folds: accuracy from 0.775", abs(accuracy - 0.775), 0.1249)


def test_n78_every_scaler_sees_the_training_views_of_its_fold_alone(numeric_row, monkeypatch):
    seen = []

    class Watched(StandardScaler):
        def fit(self, inputs, labels=None):
            seen.append(len(inputs))
            return super().fit(inputs, labels)

    monkeypatch.setattr("carff.latent_metrics.StandardScaler", Watched)
    svm_accuracy(*_clusters(20, 2, 1.0))
    wrong = abs(len(seen) - 10) + sum(count != 36 for count in seen)
    numeric_row("N78", "40 views, 10 folds: scalers that saw other than 36", wrong)


def test_rare_classes_reduce_the_folds():
    latents, labels = _clusters(20, 2, 0.1)
    assert svm_accuracy(latents[:23], labels[:23]).folds == 3


def test_n78_fewer_rows_than_folds(numeric_row):
    latents, labels = _clusters(2, 3, 0.01)
    score = svm_accuracy(latents, labels)
    numeric_row("N78", "6 views for 10 folds: folds other than 2, or no accuracy", abs(score.folds - 2))
    assert 0 <= score.accuracy <= 1


@pytest.mark.parametrize(
    ("latents", "labels", "message"),
    [
        (np.zeros((10, 8)), np.zeros(10, int), "at least two states"),
        (np.eye(8)[:3], np.array([0, 0, 1]), "class 1 has too few"),
        (np.full((10, 8), np.nan), np.tile([0, 1], 5), "10 of 10 rows are not finite"),
        (np.zeros((0, 8)), np.zeros(0, int), "there are none"),
    ],
)
def test_n78_impossible_inputs_are_named(latents, labels, message, numeric_row):
    numeric_row("N78", f"{message}: accepted", not refuses(message, svm_accuracy, latents, labels))


def test_twins_in_a_single_group_are_named():
    with pytest.raises(UserError, match="too few different views"):
        svm_accuracy(np.eye(8)[:6], np.array([0, 0, 0, 1, 1, 1]), groups=np.array([0, 0, 0, 1, 2, 3]))


def test_held_out_views_are_judged_by_the_training_views_alone():
    latents, labels = _clusters(20, 4, 0.1)
    held = np.arange(80) % 4 == 0
    score = svm_heldout(latents[~held], labels[~held], latents[held], labels[held])
    assert score.accuracy == 1.0 and score.folds == 0
    unknown = svm_heldout(latents[labels < 3], labels[labels < 3], latents[labels == 3], labels[labels == 3])
    assert unknown.accuracy == 0.0


def test_n53_subset_accuracy_by_hand(numeric_row):
    correct, mask = np.array([True, False, True, True]), np.array([True, True, True, False])
    subset = subset_accuracy(correct, mask)
    assert subset["accuracy"] == pytest.approx(2 / 3) and subset["count"] == 3
    assert subset["interval"][0] < 2 / 3 < subset["interval"][1]
    empty = subset_accuracy(correct, np.zeros(4, bool))
    wrong = float(empty != {"accuracy": None, "count": 0, "interval": None})
    numeric_row("N53", "an empty subset of views: an accuracy", wrong)


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    rows=st.integers(6, 30),
    classes=st.integers(2, 3),
    value=st.sampled_from([0.0, 1e-30, 1.0, 1e12]),
)
def test_any_finite_latents_give_a_finite_score_or_a_named_error(seed, rows, classes, value):
    rng = np.random.default_rng(seed)
    latents, labels = rng.integers(-1, 2, size=(rows, 3)) * value, rng.integers(classes, size=rows)
    try:
        score = svm_accuracy(latents, labels, groups=rng.integers(rows, size=rows))
    except UserError:
        return
    assert 0.0 <= score.accuracy <= 1.0 and score.predicted.shape == (rows,)


def test_tsne_keeps_clusters_together_and_repeats_itself():
    latents, labels = _clusters(15, 3, 0.1)
    layout = tsne_embedding(latents, seed=0)
    centres = np.stack([layout[labels == name].mean(axis=0) for name in range(3)])
    nearest = np.linalg.norm(layout[:, None] - centres[None], axis=2).argmin(axis=1)
    assert (nearest == labels).all()
    assert np.array_equal(layout, tsne_embedding(latents, seed=0))


@pytest.mark.parametrize("latents", [np.zeros((12, 8)), np.eye(4), np.ones((9, 1)) * np.arange(9)[:, None] * 1e20])
def test_tsne_of_degenerate_latents_is_finite(latents):
    assert np.isfinite(tsne_embedding(latents, seed=0)).all()


def test_tsne_of_too_few_points_is_named():
    with pytest.raises(UserError, match="at least 4"):
        tsne_embedding(np.eye(3), seed=0)
