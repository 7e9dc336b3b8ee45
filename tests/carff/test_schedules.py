import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carff.schedules import cosine_rate, delayed_linear
from hashnerf.errors import UserError
from tests.hashnerf.refusals import refuses

RAMP = (1e-6, 4e-5, 30, 60)


def test_n63_the_ramp_by_hand(numeric_row):
    # Half-way, at epoch 45: (1e-6 + 4e-5) / 2 = 2.05e-5.
    epochs = [-1, 0, 29, 30, 45, 60, 61, 1e9]
    expected = [1e-6, 1e-6, 1e-6, 1e-6, 2.05e-5, 4e-5, 4e-5, 4e-5]
    worst = max(abs(delayed_linear(epoch, *RAMP) / value - 1) for epoch, value in zip(epochs, expected))
    numeric_row("N63", "epochs -1 to 1e9 of a ramp from 30 to 60: relative error", worst, 1e-12)


def test_n63_a_resumed_ramp_is_an_uninterrupted_one_and_never_falls(numeric_row):
    # a batch of 32 of 130 views: epochs are no whole numbers
    whole = [delayed_linear(step * 32 / 130, *RAMP) for step in range(300)]
    resumed = [delayed_linear(step * 32 / 130, *RAMP) for step in range(183, 300)]  # from epoch 45 on
    differing = sum(a != b for a, b in zip(whole[183:], resumed, strict=True))
    numeric_row("N63", "resumed at epoch 45: weights that differ", differing)
    falling = sum(after < before for before, after in itertools.pairwise(whole))
    numeric_row("N63", "epochs that are no whole numbers: weights that fall", falling)


@given(st.floats(0, 100), st.floats(0, 100))
def test_the_ramp_is_monotone_for_fractions_of_epochs(first, second):
    low, high = sorted((first, second))
    assert delayed_linear(low, *RAMP) <= delayed_linear(high, *RAMP)


def test_n63_equal_epochs_make_a_step(numeric_row):
    weights = [delayed_linear(epoch, 1.0, 2.0, 30, 30) for epoch in (29, 29.99, 30, 31)]
    wrong = sum(a != b for a, b in zip(weights, [1.0, 1.0, 2.0, 2.0]))
    numeric_row("N63", "a ramp from epoch 30 to 30: wrong weights", wrong)


def test_a_falling_ramp_works_too():
    assert delayed_linear(5, 1.0, 0.0, 0, 10) == 0.5


@pytest.mark.parametrize("bad", [(0, 1.0, 2.0, 60, 30), (math.nan, *RAMP), (0, math.inf, 1.0, 0, 1)])
def test_n63_impossible_ramps_are_refused(bad, numeric_row):
    numeric_row("N63", f"epoch, weights and ends {bad}: accepted", not refuses("schedule", delayed_linear, *bad))


def test_the_cosine_by_hand():
    # Ends, middle (mean of both) and a third of the way: 0.1 + 0.45 * (1 + cos 60 deg) = 0.775.
    values = [cosine_rate(step, 90, 1.0, 0.1) for step in (0, 30, 45, 90, 1000)]
    assert values == pytest.approx([1.0, 0.775, 0.55, 0.1, 0.1])


def test_an_empty_schedule_is_refused():
    with pytest.raises(UserError, match="0 steps"):
        cosine_rate(0, 0, 1.0, 0.1)


def test_the_warm_up_rises_in_equal_parts():
    # Without the cosine's fall (initial = final = 1): 1/4, 2/4, 3/4, 1, 1.
    assert [cosine_rate(step, 100, 1.0, 1.0, warm_up=4) for step in range(5)] == pytest.approx([0.25, 0.5, 0.75, 1, 1])
