import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from carff.intervals import bootstrap_band, expected_calibration_error, reliability_table, wilson_interval
from hashnerf.errors import UserError


def test_wilson_by_hand():
    # 8 of 10, z = 1.959964, z^2 = 3.841459: centre (0.8 + 3.841459/20) / 1.3841459 = 0.716740,
    # half width 1.959964 * sqrt(0.016 + 3.841459/400) / 1.3841459 = 0.226577.
    assert wilson_interval(8, 10) == pytest.approx((0.490162, 0.943318), abs=1e-6)


def test_wilson_at_the_ends():
    # 30 of 30: low end 1 / (1 + z^2 / 30) = 0.886497; the other end is exactly 1.
    low, high = wilson_interval(30, 30)
    assert (low, high) == (pytest.approx(1 / (1 + 3.841459 / 30), abs=1e-6), 1.0)
    assert wilson_interval(0, 30) == (0.0, pytest.approx(1 - low))
    assert wilson_interval(0, 0) == (0.0, 1.0)


@given(st.integers(1, 200).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_contains_the_share_and_is_symmetric(counts):
    successes, trials = counts
    low, high = wilson_interval(successes, trials)
    assert 0 <= low <= successes / trials <= high <= 1
    assert wilson_interval(trials - successes, trials) == pytest.approx((1 - high, 1 - low))


def test_wilson_covers_a_true_share():
    # Exact coverage for n = 30, p = 0.3: the probabilities of all counts whose interval holds 0.3 add up to near 95 %.
    covered = sum(
        math.comb(30, k) * 0.3**k * 0.7 ** (30 - k)
        for k in range(31)
        if wilson_interval(k, 30)[0] <= 0.3 <= wilson_interval(k, 30)[1]
    )
    assert 0.92 < covered < 0.98


@pytest.mark.parametrize("counts", [(-1, 10), (11, 10), (0, -1)])
def test_impossible_counts_are_refused(counts):
    with pytest.raises(UserError, match="impossible"):
        wilson_interval(*counts)


def test_impossible_confidence_is_refused():
    with pytest.raises(UserError, match="confidence"):
        wilson_interval(1, 2, confidence=95.0)
    with pytest.raises(UserError, match="confidence"):
        bootstrap_band(torch.zeros(2, 2), confidence=0.0)


def test_a_band_of_equal_curves_is_that_curve():
    curve = torch.tensor([0.0, 0.5, 1.0], dtype=torch.float64)
    low, high = bootstrap_band(curve.expand(4, 3), generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(low, curve)
    torch.testing.assert_close(high, curve)


def test_the_band_has_the_width_of_the_standard_error():
    curves = torch.randn(400, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    low, high = bootstrap_band(curves, resamples=4000, generator=torch.Generator().manual_seed(2))
    expected = 2 * 1.959964 * curves.std(dim=0, correction=0) / math.sqrt(400)
    torch.testing.assert_close(high - low, expected, rtol=0.08, atol=0)
    assert ((low < curves.mean(dim=0)) & (curves.mean(dim=0) < high)).all()


def test_the_band_resamples_whole_curves_with_replacement():
    # Two mirrored curves: whenever the first point of a resampled mean is high, the second is as low.
    curves = torch.tensor([[0.0, 1.0], [1.0, 0.0]])
    low, high = bootstrap_band(curves, generator=torch.Generator().manual_seed(0))
    assert low.tolist() == [0.0, 0.0] and high.tolist() == [1.0, 1.0]


def test_a_band_needs_a_curve():
    with pytest.raises(UserError, match="at least one curve"):
        bootstrap_band(torch.zeros(0, 3))


def test_calibration_error_by_hand():
    # Bins of width 0.5. Low: 0.1, 0.3 with outcomes 0, 1 -> |0.2 - 0.5| = 0.3. High: 0.6, 0.8, 1.0 with 1, 1, 0
    # -> |0.8 - 2/3| = 0.133333. Weighted: (2 * 0.3 + 3 * 0.133333) / 5 = 0.2.
    probabilities = torch.tensor([0.1, 0.3, 0.6, 0.8, 1.0])
    outcomes = torch.tensor([False, True, True, True, False])
    assert expected_calibration_error(probabilities, outcomes, bins=2) == pytest.approx(0.2, abs=1e-6)
    low, high = reliability_table(probabilities, outcomes, bins=2)
    assert (low.count, low.mean_probability, low.frequency) == (2, pytest.approx(0.2), 0.5)
    assert (high.count, high.mean_probability, high.frequency) == (3, pytest.approx(0.8), pytest.approx(2 / 3))
    assert (high.low, high.high) == pytest.approx(wilson_interval(2, 3))


def test_equal_count_bins_hold_about_as_many_and_never_split_equal_probabilities():
    probabilities = torch.tensor([0.01, 0.02, 0.03, 0.04, 0.9, 0.9, 0.9, 0.9])
    outcomes = torch.tensor([False] * 4 + [True] * 4)
    assert [entry.count for entry in reliability_table(probabilities, outcomes, bins=4, equal_count=True)] == [2, 2, 4]


def test_equal_width_bins_put_edges_up_and_one_into_the_last():
    table = reliability_table(torch.tensor([0.0, 0.5, 1.0]), torch.tensor([False, True, True]), bins=2)
    assert [entry.count for entry in table] == [1, 2]


def test_true_probabilities_are_calibrated_and_overconfident_ones_are_not():
    generator = torch.Generator().manual_seed(0)
    truth = torch.rand(20_000, generator=generator)
    outcomes = torch.rand(20_000, generator=generator) < truth
    assert expected_calibration_error(truth, outcomes) < 0.02
    # Everything pushed to 0 or 1: the mean gap is the mean of min(p, 1 - p) = 0.25.
    assert expected_calibration_error(truth.round(), outcomes) == pytest.approx(0.25, abs=0.02)


@pytest.mark.parametrize("bad", [1.5, -0.1, math.nan])
def test_numbers_that_are_no_probabilities_are_refused(bad):
    with pytest.raises(UserError, match="between 0 and 1"):
        reliability_table(torch.tensor([0.5, bad]), torch.tensor([True, False]))


def test_no_predictions_have_no_calibration_error():
    with pytest.raises(UserError, match="no predictions"):
        expected_calibration_error(torch.zeros(0), torch.zeros(0, dtype=torch.bool))
    with pytest.raises(UserError, match="bins"):
        reliability_table(torch.zeros(1), torch.zeros(1, dtype=torch.bool), bins=0)
