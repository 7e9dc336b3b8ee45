"""What a budget allows, by hand."""

import pytest

from hashnerf.budget import MARGIN, Trial, best_within, p95_ms, trials_table, write_trials
from hashnerf.errors import UserError

COSTS = {"fast": 10.0, "balanced": 40.0, "accurate": 160.0}


def test_the_most_accurate_that_fits_with_room_to_spare():
    assert best_within(COSTS, 1000.0, "max_seconds", "s")[0] == "accurate"
    assert best_within(COSTS, 160.0, "max_seconds", "s")[0] == "balanced"  # accurate would just fit, on a quiet machine
    assert best_within(COSTS, 160.0 * MARGIN, "max_seconds", "s")[0] == "accurate"
    assert best_within(COSTS, 40.0 * MARGIN - 0.1, "max_seconds", "s")[0] == "fast"


def test_it_says_which_and_why_in_one_line():
    name, reason = best_within(COSTS, 60.0, "max_seconds", "s")
    assert name == "balanced" and "\n" not in reason
    assert "max_seconds 60: takes balanced" in reason and "fast 10 s, balanced 40 s, accurate 160 s" in reason


def test_no_preset_fits():
    with pytest.raises(UserError, match=r"max_ms is 12: no preset fits 1.3 times over \(fast 10 ms.*give at least 13"):
        best_within(COSTS, 12.0, "max_ms", "ms")


def test_a_preset_that_costs_more_but_is_worse_is_not_skipped_over_silently():
    # the order is that of accuracy, so a dear one in the middle does not stop the search
    assert best_within({"fast": 10.0, "balanced": 500.0, "accurate": 20.0}, 100.0, "max_ms", "ms")[0] == "accurate"


def test_95_per_cent_of_the_calls_count_and_the_first_two_do_not(monkeypatch):
    waits = iter([0.5, 0.5, *[0.001] * 18, 0.2, 0.2])
    now = [0.0]
    monkeypatch.setattr("hashnerf.budget.perf_counter", lambda: now[0])

    def call():
        now[0] += next(waits)

    # 20 calls: 18 of 1 ms and 2 of 200 ms; the 95 % quantile lies at rank 0.95 * 19 = 18.05, the 19th of them
    assert p95_ms(call, 20) == pytest.approx(200.0)


def test_trials_by_hand():
    trials = [
        Trial(10.0, "fast", 7.0),
        Trial(10.0, "fast", 9.5),
        Trial(60.0, "fast", 8.0),
        Trial(60.0, "balanced", 61.0),
    ]
    assert trials_table(trials, "s").rows == (
        ("10 s", "fast", "7 to 9.5 s", "2 of 2"),
        ("60 s", "fast, balanced", "8 to 61 s", "1 of 2 (**missed**)"),
    )


def test_a_trial_that_fails_costs_no_other(tmp_path):
    def trials():
        yield Trial(10.0, "fast", 7.0)
        raise UserError("no preset fits")

    page = tmp_path / "budgets.md"
    with pytest.raises(UserError, match="no preset fits"):
        write_trials({"Decisions": ("ms", [Trial(20.0, "fast", 9.0)]), "Trainings": ("s", trials())}, page, "about")
    text = page.read_text()
    assert text.index("## Decisions") < text.index("| 20 ms |") < text.index("## Trainings") < text.index("| 10 s |")
    assert "about" in text
