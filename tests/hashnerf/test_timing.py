"""Timing in turns: order, warm-up and the median, with a clock of the test's own."""

import itertools

import pytest

from hashnerf import timing
from hashnerf.timing import seconds_in_turns


def test_functions_take_turns_and_the_first_turn_does_not_count(monkeypatch):
    # the clock is read before and after each call: a takes 100 s, then 1, 9 and 2 s; b always half a second
    lasting = itertools.chain([100.0, 0.5], [1.0, 0.5], [9.0, 0.5], [2.0, 0.5])
    clock = itertools.accumulate(itertools.chain.from_iterable((0.0, seconds) for seconds in lasting))
    monkeypatch.setattr(timing, "perf_counter", lambda: next(clock))
    called = []
    taken = seconds_in_turns({"a": lambda: called.append("a"), "b": lambda: called.append("b")}, turns=3)
    assert called == ["a", "b"] * 4
    assert taken == {"a": 2.0, "b": 0.5}


def test_no_turn_is_no_measurement():
    with pytest.raises(ValueError, match="0 turns"):
        seconds_in_turns({}, 0)
