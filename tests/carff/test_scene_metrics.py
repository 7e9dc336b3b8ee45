import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carff.scene_metrics import (
    changed_pixels,
    changed_psnr,
    equal_states,
    mean_psnr_db,
    psnr_db,
    psnr_matrix,
    scene_summary,
    state_identified,
)


def _flat(*levels: float) -> np.ndarray:
    """One 4 x 4 grey picture per level."""
    return np.stack([np.full((4, 4, 3), level) for level in levels])


def _moving_square(states: int, size: int = 8) -> np.ndarray:
    """A white pixel that stands at column s in state s on grey ground."""
    pictures = np.full((states, size, size, 3), 0.5)
    for state in range(states):
        pictures[state, 0, state] = 1.0
    return pictures


def test_psnr_by_hand():
    # mse 0.01 -> -10 log10(0.01) = 20 dB; 0.1^2 against 0.3^2: 20 dB and 10.4576 dB.
    matrix = psnr_matrix(_flat(0.5), _flat(0.6, 0.8, 0.5))
    np.testing.assert_allclose(matrix, [[20.0, 10.457574905606752, np.inf]])


def test_integer_and_float_pictures_give_the_same_matrix():
    rng = np.random.default_rng(0)
    a, b = rng.integers(0, 256, (2, 5, 4, 3)).astype(np.uint8), rng.integers(0, 256, (3, 5, 4, 3)).astype(np.uint8)
    np.testing.assert_allclose(psnr_matrix(a, b), psnr_matrix((a / 255).astype(np.float32), b), rtol=1e-5)


def test_n50_means_leave_out_identical_pictures_and_count_them(numeric_row):
    summary = scene_summary(_flat(0.2, 0.5), _flat(0.2, 0.6))
    # The first is identical, the second has mse 0.01; the PSNR of the mean error 0.005 is 23.01 dB.
    wrong = (summary["identical"] != 1) + (summary["psnr_matrix_db"][0][0] is not None)
    numeric_row("N50", "two states, one shown perfectly: not counted, or a number", wrong)
    numeric_row("N50", "the same: mean PSNR from 20 dB", abs(summary["psnr_matched_db"] - 20), 1e-5)
    worst = abs(summary["psnr_matched_of_mean_mse_db"] - 23.0103)
    numeric_row("N50", "the same: PSNR of the mean error from 23.0103 dB", worst, 1e-4)
    json.dumps(summary, allow_nan=False)


def test_n53_mean_of_nothing_is_none(numeric_row):
    numeric_row("N53", "no finite PSNR: a mean", float(mean_psnr_db(np.array([np.inf, np.nan])) is not None))
    assert np.isnan(psnr_db(np.nan))
    summary = scene_summary(_flat(0.2, 0.3), _flat(0.5, 0.5))
    wrong = (summary["changed_px_db"] is not None) + (summary["changed_px_count"] != 0)
    numeric_row("N53", "two equal states, no pixel changes: a PSNR of the changed pixels", wrong)
    json.dumps(summary, allow_nan=False)


def test_changed_pixels_are_those_where_any_two_states_differ():
    mask = changed_pixels(_moving_square(3))
    assert mask.sum() == 3 and mask[0, :3].all()
    assert not changed_pixels(_moving_square(1)).any()
    assert not changed_pixels(_flat(0.5, 0.52), threshold=0.03).any()
    assert changed_pixels(_flat(0.5, 0.52), threshold=0.01).all()


def test_one_changed_channel_is_enough():
    pictures = _flat(0.5, 0.5)
    pictures[1, 2, 1, 2] = 0.9
    assert changed_pixels(pictures).sum() == 1


def test_equal_states_pair_up_shared_pictures():
    truth = _moving_square(3)[[0, 1, 0]]
    assert (equal_states(truth) == [[True, False, True], [False, True, False], [True, False, True]]).all()


def test_changed_psnr_by_hand():
    # States differ in two pixels: (0,0) and (0,1), white in one and grey (0.5) in the other. A rendering of state 0
    # that is 0.1 off on both: own error 0.1 -> 20 dB; against state 1: errors 0.4 and 0.4 -> -20 log10(0.4) = 7.9588
    # dB; lead 12.0412 dB.
    truth = _moving_square(2)
    rendered = truth[:1].copy()
    rendered[0, 0, 0], rendered[0, 0, 1] = 0.9, 0.6
    result = changed_psnr(rendered, truth, changed_pixels(truth), np.array([0]))
    assert result.matched[0] == pytest.approx(20.0)
    assert result.unmatched[0] == pytest.approx(7.9588, abs=1e-4)
    assert result.lead[0] == pytest.approx(12.0412, abs=1e-4)


def test_unmatched_looks_only_at_the_pixels_of_its_own_pair():
    # The background is wrong by 0.3 everywhere: whole pictures suffer, the changed pixels (rendered exactly) do not.
    truth = _moving_square(3)
    rendered = truth - 0.3
    rendered[:, 0, :3] = truth[:, 0, :3]
    result = changed_psnr(rendered, truth, changed_pixels(truth))
    assert np.isinf(result.matched).all()
    # Against another state: both differing pixels are wrong by 0.5 -> 6.0206 dB.
    np.testing.assert_allclose(result.unmatched, 6.0206, atol=1e-4)


def test_the_lead_compares_both_sides_on_the_same_pixels():
    # State 0 rendered with errors 0.1, 0.1, 0.4 in pixels 0, 1, 2. Pair (0, 1), pixels 0 and 1: own 20 dB, other 0.4
    # and 0.4, 7.9588 dB, lead 12.0412. Pair (0, 2), pixels 0 and 2: own mse (0.01 + 0.16) / 2, other (0.16 + 0.01) / 2,
    # lead 0. Mean 6.0206.
    truth = _moving_square(3)
    rendered = truth[:1].copy()
    rendered[0, 0, :3] = [[0.9] * 3, [0.6] * 3, [0.9] * 3]
    assert changed_psnr(rendered, truth, changed_pixels(truth)).lead[0] == pytest.approx(6.0206, abs=1e-4)


def test_a_rendering_of_the_wrong_state_has_a_negative_lead():
    truth = _moving_square(2)
    assert (changed_psnr(truth[::-1] * 0.99, truth, changed_pixels(truth)).lead < 0).all()


def test_identification_accepts_any_state_with_the_same_picture():
    truth = _moving_square(3)[[0, 1, 0]]
    matrix = psnr_matrix(np.clip(truth + 0.01, 0, 1), truth)
    assert state_identified(matrix, equal_states(truth)).all()
    assert state_identified(matrix, np.eye(3, dtype=bool)).tolist() == [True, True, False]
    assert state_identified(matrix[:1], equal_states(truth), np.array([1])).tolist() == [False]


def test_summary_of_a_good_rendering():
    truth = _moving_square(4)
    summary = scene_summary(np.clip(truth + 0.01, 0, 1), truth)
    assert summary["state_identified"] == 1.0 and summary["state_identified_count"] == summary["states"] == 4
    assert summary["changed_px_count"] == 4 and summary["changed_px_share"] == pytest.approx(4 / 64)
    assert summary["changed_px_lead_db"] > 20
    assert summary["psnr_matched_db"] > summary["psnr_unmatched_db"]


def test_summary_of_a_single_state_has_no_comparison():
    summary = scene_summary(_flat(0.5), _flat(0.6))
    assert summary["psnr_unmatched_db"] is None and summary["changed_px_db"] is None
    assert summary["changed_px_lead_db"] is None and summary["changed_px_count"] == 0
    assert summary["state_identified"] == 1.0


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), states=st.integers(1, 4))
def test_matrix_equals_the_slow_definition(seed, states):
    rng = np.random.default_rng(seed)
    rendered, truth = rng.random((2, states, 3, 2, 3))
    matrix = psnr_matrix(rendered, truth)
    for i in range(states):
        for j in range(states):
            total = 0.0
            for a, b in zip(rendered[i].ravel().tolist(), truth[j].ravel().tolist()):
                total += (a - b) ** 2
            assert matrix[i, j] == pytest.approx(-10 * np.log10(total / 18))
