"""Parts of a run measured alone agree with the whole evaluation."""

import json
from dataclasses import replace

import pytest
import torch

from carff import measured_parts
from carff.evaluate_beliefs import svm_scores
from carff.measured_parts import measure_beliefs, measure_decisions, measure_forecast, measure_parts
from hashnerf.errors import UserError


@pytest.fixture
def known(tiny_evaluation, monkeypatch):
    """The evaluation of a run that knows everything, in place of one that is loaded."""
    monkeypatch.setattr(measured_parts, "load_evaluation_data", lambda config: tiny_evaluation)
    monkeypatch.setattr(measured_parts, "load_belief_data", lambda config: (tiny_evaluation.beliefs, {"seconds": 2.5}))
    monkeypatch.setattr(measured_parts, "decision_milliseconds", lambda model, pictures, n, generator: 10.0 + n)
    return tiny_evaluation


def test_beliefs_are_those_of_the_report(known):
    found = measure_beliefs(known.config)
    scores, _ = svm_scores(known.beliefs)
    assert scores.items() <= found.items()
    assert found["seconds"] == 2.5 and found["psnr_train_db"] > 10


def test_a_forecast_that_knows_what_follows_has_no_error(known):
    found = measure_forecast(known)
    assert set(found) == {"branch_ece", "branch_mae", "ambiguous_branch_error", "unknown_share", "seconds"}
    assert found["ambiguous_branch_error"] < 0.2 and found["seconds"] == 1.5


def test_decisions_are_counted_by_rule(known):
    found = measure_decisions(known, 10)
    assert found["decision_ms"] == 20.0 and 0 <= found["probe_accuracy"] <= 1
    for rule in ("risk", "paper"):
        own = found[rule]
        assert own["success"] == pytest.approx((own["hazard_success"] + own["clear_success"]) / 2)
    assert measure_decisions(known, 1)["risk"] == {"hazard_success": 1.0, "clear_success": 0.0, "success": 0.5}


def test_without_both_kinds_there_is_nothing_to_decide(known):
    none = replace(known, table=replace(known.table, hazard=None))
    with pytest.raises(UserError, match="has no pictures of both kinds"):
        measure_decisions(none, 2)


def test_only_what_is_asked_is_measured_and_kept(known, monkeypatch):
    monkeypatch.setattr(measured_parts, "set_threads", lambda count: torch.set_num_threads(1))
    path = measure_parts(known.config, ["beliefs", "decisions"], 3)
    found = json.loads(path.read_text())
    assert path == known.config.folder / "measures.json" and set(found) == {"beliefs", "decisions"}
    assert found["decisions"]["decision_ms"] == 13.0
    assert set(json.loads(measure_parts(known.config, ["forecast"], 3).read_text())) == {"forecast"}
    with pytest.raises(UserError, match="parts: 'belief' is none; did you mean 'beliefs'"):
        measure_parts(known.config, ["belief"], 3)
    with pytest.raises(UserError, match="futures is 0"):
        measure_parts(known.config, ["beliefs"], 0)
