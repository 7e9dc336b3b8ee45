"""From pictures to decisions."""

import torch

from carff.decisions import decide_from_pictures, sample_next_states
from carff.planner import PlannerConfig


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def test_samples_are_next_states_and_equal_seeds_give_equal_ones(tiny_evaluation):
    views = tiny_evaluation.views
    clear = views.belief.select((views.camera == 1) & (views.state == 2))
    assert (sample_next_states(tiny_evaluation.model, clear, 7, generator()) == 3).all()
    hidden = views.belief.select((views.camera == 0) & (views.state == 0))
    states = sample_next_states(tiny_evaluation.model, hidden, 400, generator())
    assert states.shape == (1, 400) and set(states.unique().tolist()) == {1, 3}
    assert 150 < int((states == 3).sum()) < 250  # one half, within 5 standard deviations of 10
    assert torch.equal(states, sample_next_states(tiny_evaluation.model, hidden, 400, generator()))


def test_one_decision_per_picture(tiny_evaluation):
    table, images = tiny_evaluation.table, tiny_evaluation.data.images
    pictures = images[torch.stack([table.views[0, 1], table.views[2, 1], table.views[0, 0]])]
    decisions = decide_from_pictures(tiny_evaluation.model, pictures, PlannerConfig(rule="risk"), 35, generator())
    assert [one.go for one in decisions] == [True, False, False], "clear; the truck is there; it may be hidden"
    assert [one.samples for one in decisions] == [35] * 3
    assert decisions[1].hazards == 35 and 5 < decisions[2].hazards < 30
