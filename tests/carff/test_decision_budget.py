"""How many futures a time limit allows."""

import pytest

from carff import decision_budget
from carff.decision_budget import samples_within
from hashnerf.errors import UserError


def test_as_many_futures_as_fit(tiny_evaluation, monkeypatch, capsys):
    asked = []

    def decide(model, pictures, planner, n, generator):
        asked.append((n, tuple(pictures.shape)))

    def p95(function, calls):
        function()
        return 2.0 * asked[-1][0]  # 2 ms a future

    monkeypatch.setattr(decision_budget, "decide_from_pictures", decide)
    monkeypatch.setattr(decision_budget, "p95_ms", p95)
    model = tiny_evaluation.model
    assert samples_within(model, 30.0) == 10
    assert "takes balanced" in (said := capsys.readouterr().err) and "10 sampled futures" in said
    cameras = model.scene.cameras
    assert asked == [(n, (1, cameras.height, cameras.width, 3)) for n in (5, 10)]
    assert samples_within(model, 1000.0, {"fast": 5, "accurate": 35}) == 35
    with pytest.raises(UserError, match="max_ms is 5: no preset fits"):
        samples_within(model, 5.0)


def test_what_is_timed_are_real_decisions(tiny_evaluation, monkeypatch):
    decided = []

    def p95(function, calls):
        decided.append(function())
        return 1.0

    monkeypatch.setattr(decision_budget, "p95_ms", p95)
    assert samples_within(tiny_evaluation.model, 100.0, {"few": 2, "more": 3}) == 3
    assert [len(decisions) for decisions in decided] == [1, 1] and hasattr(decided[0][0], "hazard_probability")
