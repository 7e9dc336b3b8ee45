"""Calibration and curves on a run that forecasts the truth, and on one that does not."""

from dataclasses import replace

import pytest
import torch

from carff.evaluate_forecast import (
    branch_probability,
    branch_votes,
    distinct_pictures,
    evaluate_forecast,
    plausible_labels,
)
from carff.states import build_state_table


def test_a_true_forecast_is_calibrated(tiny_evaluation):
    part = evaluate_forecast(tiny_evaluation)
    forecast = part.results["forecast"]
    # First steps only: 2 states x 4 cameras; the two views of camera 0 share a picture that fits both branches.
    assert forecast["views"] == 8 and forecast["calibration"]["ambiguous"]["views"] == 2
    assert forecast["calibration"]["ambiguous"]["mean_frequency"] == [0.5, 0.5]
    # 100 draws: the standard deviation of a share is 5 points, and only 2 of 8 views can be off
    assert forecast["branch_ece"] < 0.06 and forecast["ambiguous_branch_error"] < 0.2
    assert forecast["unknown_share"] == 0 and forecast["views_without_answer"] == 0
    assert forecast["calibration_train"]["views"] == 6 and forecast["calibration_test"]["views"] == 2
    assert forecast["calibration_ego"]["views"] == 6
    assert set(part.figures) == {"accuracy_recall", "accuracy_recall_latents", "calibration"} and not part.not_run


def test_a_true_forecast_uses_as_many_components_as_the_pictures_ask_for(tiny_evaluation):
    # two of eight views leave two states open, evenly: exp(ln 2) = 2 each, the others 1: (2 * 2 + 6) / 8
    use = evaluate_forecast(tiny_evaluation).results["forecast"]["components"]
    assert use["needed"] == pytest.approx(1.25) and use["used"] == pytest.approx(1.25, abs=1e-3)
    assert (use["there"], use["needed_most"]) == (4, 2)


def test_curves_of_a_true_forecast(tiny_evaluation):
    forecast = evaluate_forecast(tiny_evaluation).results["forecast"]
    ahead = forecast["accuracy_recall"]
    # Of the ego's pictures (cameras 0, 1, 2) four settle the next state (2 states x 2 cameras), one leaves it open.
    assert ahead["accuracy"]["images"] == 4 and ahead["recall"]["images"] == 1
    assert (ahead["accuracy"]["mean"] == 1).all() and (ahead["all_correct"]["mean"] == 1).all()
    # recall by closed form for p = 1/2: 1 - (1/2)^n, so 1/2 at n = 1
    assert ahead["recall"]["mean"][0] == pytest.approx(0.5) and ahead["recall"]["mean"][-1] > 0.8
    now = forecast["accuracy_recall_latents"]
    # All steps: 4 states x 2 cameras settle the present, two pictures of camera 0 do not.
    assert now["accuracy"]["images"] == 8 and now["recall"]["images"] == 2
    assert (now["accuracy"]["mean"] == 1).all()
    # A belief between two states is no state: its samples are unknown, and nothing is recalled.
    assert (now["recall"]["mean"] == 0).all()


def test_an_overconfident_forecast_is_found_out(tiny_evaluation, monkeypatch):
    monkeypatch.setattr(tiny_evaluation.model.mdn, "successor", torch.tensor([1, -1, 1, -1]))  # never a truck
    forecast = evaluate_forecast(tiny_evaluation).results["forecast"]
    # Absent forecast with certainty: off by 1/2 on the ambiguous views and by 1 on the three that show the truck.
    assert forecast["ambiguous_branch_error"] == pytest.approx(0.5)
    assert forecast["branch_ece"] == pytest.approx((2 * 0.5 + 3 * 1.0) / 8)


def test_unknown_samples_are_counted_and_leave_no_probability(tiny_evaluation, monkeypatch):
    model = type(tiny_evaluation.model)
    monkeypatch.setattr(model, "probe_scores", lambda self, latents: torch.full((len(latents), 4), 0.5))
    part = evaluate_forecast(tiny_evaluation)
    forecast = part.results["forecast"]
    assert forecast["unknown_share"] == forecast["unknown_state_share"] == 1.0
    assert forecast["views_without_answer"] == 8
    assert set(part.not_run) == {"forecast.branch_ece", "forecast.ambiguous_branch_error", "calibration"}


def test_a_branch_may_be_certain_where_the_state_is_not(tiny_evaluation, monkeypatch):
    model = type(tiny_evaluation.model)
    seen = model.probe_scores

    def without_ego(self, latents):  # boxes: ego, ego, truck, truck
        scores = seen(self, latents)
        scores[:, :2] = 0.5
        return scores

    monkeypatch.setattr(model, "probe_scores", without_ego)
    forecast = evaluate_forecast(tiny_evaluation).results["forecast"]
    assert forecast["unknown_share"] == 0.0, "no truck: absent, at whichever step"
    assert 0.2 < forecast["unknown_state_share"] < 0.8
    assert forecast["branch_ece"] < 0.06


def test_a_single_branch_has_curves_but_nothing_to_calibrate(tiny_evaluation):
    data = tiny_evaluation.data
    rows = [row for row, frame in enumerate(data.frames) if frame.branch == 0]
    one = replace(
        tiny_evaluation.table,
        branch_names=("absent",),
        branch_weight=torch.ones(1),
        states=((0, 0), (0, 1), (0, 2), (0, 3)),
    )
    part = evaluate_forecast(replace(tiny_evaluation, table=one))
    assert "single branch" in part.not_run["forecast.branch_ece"]
    assert part.results["forecast"]["branch_ece"] is None and "accuracy_recall" in part.figures
    assert len(rows) == 8 and len(build_state_table(data)) == 4


def test_votes_by_hand(tiny_evaluation):
    occupied = tiny_evaluation.model.probe.candidates.occupied
    occupied[2] = occupied[0]  # the branches cannot be told apart at step 0
    states, branch = torch.tensor([0, 3, -1, -1]), torch.tensor([-1, 1, 0, -1])
    votes = branch_votes(states, branch, tiny_evaluation)
    # a state of both branches counts half for each; an unknown state of a known branch for that; the last says nothing
    assert votes.tolist() == [[0.5, 0.5], [0.0, 1.0], [1.0, 0.0], [0.0, 0.0]]


def test_branch_probability_by_hand():
    votes = torch.tensor([[[1.0, 0.0], [0.5, 0.5], [0.0, 0.0]], [[0.0, 0.0]] * 3])
    probability, answered = branch_probability(votes)
    assert probability[0].tolist() == [0.75, 0.25] and probability[1].isnan().all()
    assert answered.tolist() == [True, False]


def test_plausible_labels_and_distinct_pictures(tiny_evaluation):
    plausible = plausible_labels(torch.tensor([0, 0, 1]), torch.tensor([1, 3, 2]), 2, 4)
    assert plausible.tolist() == [[False, True, False, True], [False, False, True, False]]
    views = tiny_evaluation.views
    pictures = distinct_pictures(views)
    assert len(pictures.view) == 14
    assert torch.equal(views.picture[pictures.view][pictures.of_view], views.picture)
    assert (pictures.view[pictures.of_view] <= torch.arange(16)).all(), "the first view of each picture"
