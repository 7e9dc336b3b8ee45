import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carff.schedules import cosine_rate, delayed_linear
from hashnerf.errors import UserError

RAMP = (1e-6, 4e-5, 30, 60)


def test_the_ramp_by_hand():
    # Half-way, at epoch 45: (1e-6 + 4e-5) / 2 = 2.05e-5.
    epochs = [-1, 0, 29, 30, 45, 60, 61, 1e9]
    expected = [1e-6, 1e-6, 1e-6, 1e-6, 2.05e-5, 4e-5, 4e-5, 4e-5]
    assert [delayed_linear(epoch, *RAMP) for epoch in epochs] == pytest.approx(expected, rel=1e-12)


@given(st.floats(0, 100), st.floats(0, 100))
def test_the_ramp_is_monotone_for_fractions_of_epochs(first, second):
    low, high = sorted((first, second))
    assert delayed_linear(low, *RAMP) <= delayed_linear(high, *RAMP)


def test_equal_epochs_make_a_step():
    assert [delayed_linear(epoch, 1.0, 2.0, 30, 30) for epoch in (29, 29.99, 30, 31)] == [1.0, 1.0, 2.0, 2.0]


def test_a_falling_ramp_works_too():
    assert delayed_linear(5, 1.0, 0.0, 0, 10) == 0.5


@pytest.mark.parametrize("bad", [(0, 1.0, 2.0, 60, 30), (math.nan, *RAMP), (0, math.inf, 1.0, 0, 1)])
def test_impossible_ramps_are_refused(bad):
    with pytest.raises(UserError, match="schedule"):
        delayed_linear(*bad)


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
