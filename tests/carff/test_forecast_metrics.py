import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carff.forecast_metrics import accuracy_recall_curves, branch_calibration, branch_frequency

CLEAR, OPEN = [True, False, False], [True, True, False]


def _samples(*runs: list[int]) -> np.ndarray:
    return np.array(runs)[None]


def test_accuracy_is_the_share_of_right_draws():
    curves = accuracy_recall_curves(_samples([0, 0, 1, 0]), np.array([CLEAR]))
    np.testing.assert_allclose(curves.accuracy.mean, [1, 1, 2 / 3, 3 / 4])
    np.testing.assert_allclose(curves.all_correct.mean, [1, 1, 0, 0])
    np.testing.assert_allclose(curves.accuracy.closed_form, 3 / 4)
    assert curves.recall is None and curves.accuracy.images == 1


def test_recall_is_the_share_of_plausible_labels_seen():
    # Runs 0,0,1 and 1,0,0: after 1, 2, 3 draws the first has seen 1, 1, 2 of 2 labels, the second 1, 2, 2.
    curves = accuracy_recall_curves(_samples([0, 0, 1], [1, 0, 0]), np.array([OPEN]))
    np.testing.assert_allclose(curves.recall.mean, [0.5, 0.75, 1.0])
    # Label 0 has probability 4/6, label 1 has 2/6: n = 1 gives (4/6 + 2/6) / 2 = 1/2, n = 2 gives (1 - 1/9 + 1 - 4/9) /
    # 2 = 13/18.
    np.testing.assert_allclose(curves.recall.closed_form[:2], [0.5, 13 / 18])
    assert curves.accuracy is None and curves.all_correct is None


def test_unknown_and_foreign_labels_are_wrong():
    curves = accuracy_recall_curves(_samples([-1, 7, -1]), np.array([[True, False, False]]))
    np.testing.assert_allclose(curves.accuracy.mean, 0.0)
    recall = accuracy_recall_curves(_samples([-1, 7, 2]), np.array([[True, True, True]])).recall
    np.testing.assert_allclose(recall.mean, [0, 0, 1 / 3])


def test_an_image_without_a_plausible_label_is_refused():
    with pytest.raises(ValueError, match="image 1 has no plausible label"):
        accuracy_recall_curves(np.zeros((2, 1, 3), int), np.array([CLEAR, [False] * 3]))


def test_curves_of_independent_draws_follow_their_closed_forms():
    # 40 images x 50 runs of fair coins; the mean over 2,000 runs has standard deviation below 0.25 / sqrt(2000) =
    # 0.0056 (recall of one run lies in {0.5, 1}); 4 of them.
    rng = np.random.default_rng(0)
    samples = rng.integers(2, size=(40, 50, 12))
    open_ = accuracy_recall_curves(samples, np.tile(OPEN, (40, 1)), bootstraps=200).recall
    n = np.arange(1, 13)
    np.testing.assert_allclose(open_.mean, 1 - 0.5**n, atol=4 * 0.0056)
    np.testing.assert_allclose(open_.mean, open_.closed_form, atol=4 * 0.0056)
    clear = accuracy_recall_curves(samples, np.tile(CLEAR, (40, 1)), bootstraps=200)
    np.testing.assert_allclose(clear.all_correct.mean, 0.5**n, atol=4 * 0.0112)
    np.testing.assert_allclose(clear.all_correct.closed_form, 0.5**n, atol=0.03)
    np.testing.assert_allclose(clear.accuracy.mean, 0.5, atol=4 * 0.0112)


def test_the_band_covers_the_true_value_and_shrinks_with_images():
    rng = np.random.default_rng(1)

    def width(images: int) -> float:
        samples = (rng.random((images, 5, 10)) < 0.3).astype(int)
        curve = accuracy_recall_curves(samples, np.tile(CLEAR, (images, 1)), bootstraps=400).accuracy
        assert (curve.low <= curve.mean).all() and (curve.mean <= curve.high).all()
        assert curve.low[-1] <= 0.7 <= curve.high[-1]
        return float((curve.high - curve.low)[-1])

    # The standard error falls with the square root of the number of images: 16 times the images, about a quarter of the
    # width.
    assert width(160) < 0.5 * width(10)


def test_a_single_image_gets_its_band_from_its_runs():
    samples = np.tile([[0], [1]], (10, 1))[None]
    curve = accuracy_recall_curves(samples, np.array([CLEAR]), bootstraps=200).accuracy
    assert curve.low[0] < 0.5 < curve.high[0]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), draws=st.integers(1, 8))
def test_recall_rises_and_all_correct_falls(seed, draws):
    rng = np.random.default_rng(seed)
    samples = rng.integers(-1, 4, size=(3, 2, draws))
    plausible = rng.random((3, 3)) < 0.5
    plausible[:, 0] = True
    curves = accuracy_recall_curves(samples, plausible, bootstraps=20)
    if curves.recall is not None:
        assert (np.diff(curves.recall.mean) >= -1e-12).all()
    if curves.all_correct is not None:
        assert (np.diff(curves.all_correct.mean) <= 1e-12).all()
        assert (curves.all_correct.mean <= curves.accuracy.mean + 1e-12).all()


def test_frequency_of_a_branch_is_its_share_among_equal_pictures():
    # Picture 5 is seen in branches 0 and 1, picture 9 in branch 1 alone, picture 2 in branches 0, 1, 1.
    frequency = branch_frequency(np.array([5, 5, 9, 2, 2, 2]), np.array([0, 1, 1, 0, 1, 1]), np.ones(2))
    np.testing.assert_allclose(frequency, [[0.5, 0.5]] * 2 + [[0, 1]] + [[1 / 3, 2 / 3]] * 3)
    # Branch 0 happens twice as often: 2 : 1 in picture 5, 2 : 2 in picture 2.
    frequency = branch_frequency(np.array([5, 5, 2, 2, 2]), np.array([0, 1, 0, 1, 1]), np.array([0.5, 0.25]))
    np.testing.assert_allclose(frequency, [[2 / 3, 1 / 3]] * 2 + [[0.5, 0.5]] * 3)


def test_calibration_by_hand():
    # An ambiguous view predicted 0.6 / 0.4 and a clear one predicted 0.9 / 0.1, each off by 0.1 in both branches, in
    # four bins.
    probability, frequency = np.array([[0.65, 0.35], [0.95, 0.05]]), np.array([[0.5, 0.5], [1.0, 0.0]])
    result = branch_calibration(probability, frequency, np.array([0, 2]))
    assert result["ece"] == pytest.approx((0.15 + 0.15 + 0.05 + 0.05) / 4)
    assert result["mae"] == pytest.approx(0.1)
    assert result["by_visibility"]["none"]["ece"] == pytest.approx(0.15)
    assert result["by_visibility"]["full"]["ece"] == pytest.approx(0.05)
    assert result["by_visibility"]["partial"] == {"views": 0, "ece": None, "mae": None, "bins": []}
    assert result["ambiguous"]["views"] == 1 and result["ambiguous"]["error"] == pytest.approx(0.15)
    assert result["ambiguous"]["mean_probability"] == pytest.approx([0.65, 0.35])


def test_errors_that_cancel_in_a_bin_still_show_in_the_mean_absolute_error():
    probability = np.array([[0.55, 0.45], [0.58, 0.42]])
    result = branch_calibration(probability, np.array([[0.13, 0.87], [1.0, 0.0]]), np.array([0, 0]))
    assert result["ece"] < 0.01 and result["mae"] > 0.4


def test_perfect_predictions_have_no_error():
    frequency = np.array([[1.0, 0.0, 0.0], [0.5, 0.25, 0.25], [0.0, 0.0, 1.0]])
    result = branch_calibration(frequency, frequency, np.array([2, 0, 1]))
    assert result["ece"] == 0.0 and result["ambiguous"]["error"] == 0.0


def test_a_single_branch_says_why_there_is_no_calibration():
    result = branch_calibration(np.ones((4, 1)), np.ones((4, 1)), np.array([0, 1, 2, 2]))
    assert result["ece"] is None and "single branch" in result["reason"]


def test_data_without_ambiguous_views():
    frequency = np.eye(2)
    assert branch_calibration(frequency, frequency, np.array([2, 2]))["ambiguous"]["error"] is None


@pytest.mark.parametrize("row", [[0.5, 0.6], [np.nan, 1.0], [0.0, 0.0]])
def test_probabilities_that_are_none_are_refused(row):
    with pytest.raises(ValueError, match="sum to 1"):
        branch_calibration(np.array([row]), np.array([[0.5, 0.5]]), np.array([0]))
