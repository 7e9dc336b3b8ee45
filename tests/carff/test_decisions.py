"""From pictures to decisions."""

import pytest
import torch

from carff.beliefs import Belief
from carff.decisions import decide_from_pictures, sample_next_scores, sample_scenes
from carff.planner import PlannerConfig


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def next_states(evaluation, belief: Belief, n: int) -> torch.Tensor:
    scores = sample_next_scores(evaluation.model, belief, n, generator())
    return evaluation.model.probe.classify(scores.flatten(0, 1)).reshape(len(belief), n)


def test_samples_are_next_states_and_equal_seeds_give_equal_ones(tiny_evaluation):
    views = tiny_evaluation.views
    clear = views.belief.select((views.camera == 1) & (views.state == 2))
    assert (next_states(tiny_evaluation, clear, 7) == 3).all()
    hidden = views.belief.select((views.camera == 0) & (views.state == 0))
    states = next_states(tiny_evaluation, hidden, 400)
    assert states.shape == (1, 400) and set(states.unique().tolist()) == {1, 3}
    assert 150 < int((states == 3).sum()) < 250  # one half, within 5 standard deviations of 10
    assert torch.equal(states, next_states(tiny_evaluation, hidden, 400))


def test_the_last_state_is_its_own_future(tiny_evaluation):
    views, model = tiny_evaluation.views, tiny_evaluation.model
    for state, expected in ((0, {1}), (1, {1}), (2, {3}), (3, {3})):
        belief = views.belief.select((views.camera == 1) & (views.state == state))
        scores = sample_scenes(model, belief, 20, generator()).future
        assert scores.shape[:2] == (1, 20)
        assert set(model.probe.classify(scores.flatten(0, 1)).tolist()) == expected


@pytest.mark.parametrize("last, stays", [(0, False), (2, False), (3, True), (5, True)])
def test_last_states_stand_for_their_own_future_where_most_presents_are_such(tiny_evaluation, monkeypatch, last, stays):
    # Boxes: ego at t0, ego at t1, truck at t0, truck at t1. Five presents: the last state, or half of both steps.
    model, views = tiny_evaluation.model, tiny_evaluation.views
    present = torch.tensor([[0.0, 1.0, 0.0, 1.0]] * last + [[0.5, 0.5, 0.5, 0.5]] * (5 - last))
    assert model.probe.classify(present).tolist() == [3] * last + [-1] * (5 - last)
    belief = views.belief.select((views.camera == 1) & (views.state == 0))
    ahead = sample_next_scores(model, belief, 5, generator(), systematic=True)
    monkeypatch.setattr("carff.decisions.sample_next_scores", lambda *_, **__: ahead)
    monkeypatch.setattr(type(model), "probe_scores", lambda self, latents: present)
    scenes = sample_scenes(model, belief, 5, generator())
    expected = torch.cat([present[None, :last], ahead[:, last:]], dim=1) if stays else ahead
    assert torch.equal(scenes.future, expected)
    assert torch.equal(scenes.present, present[None])


def test_one_decision_per_picture(tiny_evaluation):
    table, images = tiny_evaluation.table, tiny_evaluation.data.images
    pictures = images[torch.stack([table.views[0, 1], table.views[2, 1], table.views[0, 0]])]
    decisions = decide_from_pictures(tiny_evaluation.model, pictures, PlannerConfig(rule="risk"), 35, generator())
    assert [one.go for one in decisions] == [True, False, False], "clear; the truck is there; it may be hidden"
    assert [one.samples for one in decisions] == [35] * 3
    assert decisions[1].hazards == 35 and 5 < decisions[2].hazards < 30


def test_not_knowing_where_the_ego_stands_does_not_hide_the_hazard(tiny_evaluation, monkeypatch):
    # Boxes: ego at t0, ego at t1, truck at t0, truck at t1. The ego is seen in neither place, the truck clearly.
    scores = torch.tensor([[0.5, 0.5, 0.0, 1.0], [0.5, 0.5, 0.0, 0.0], [0.5, 0.5, 0.5, 0.5]])
    model = tiny_evaluation.model
    assert model.probe.candidates.names == ("ego", "ego", "truck", "truck")
    hazard, unknown = model.hazards(scores)
    assert hazard.tolist() == [True, False, False] and unknown.tolist() == [False, False, True]
    assert model.probe.classify(scores).tolist() == [3, -1, -1], "the empty scene could be either step"
