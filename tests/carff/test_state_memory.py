"""What earlier pictures rule out: the filter by hand, and that it only adds caution."""

import pytest
import torch

from carff.decisions import decide_from_pictures
from carff.planner import PlannerConfig
from carff.state_memory import DOUBT, TRUST_IN_CONTRADICTION, StateMemory, state_transitions

# 0 -> 1 (clear), 2 -> 3 (truck); the boxes of the ego are left out: 0 and 1 are one reading
SAME = torch.tensor([[1, 1, 0, 0], [1, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]).bool()
TRANSITIONS = torch.tensor([[0.0, 1, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1], [0, 0, 0, 1]])
ALL = torch.eye(4)


def reading(state: int, samples: int = 1) -> torch.Tensor:
    return ALL[[state] * samples]


def memory_of(state: int, pictures: int, step_seconds: float = 1.0) -> StateMemory:
    memory = StateMemory(TRANSITIONS, SAME, step_seconds)
    for _ in range(pictures):
        memory.rule_out(0.0, reading(state))
    return memory


def test_the_first_picture_rules_nothing_out():
    memory = StateMemory(TRANSITIONS, SAME, 1.0)
    assert not memory.rule_out(0.0, ALL).any()
    assert torch.allclose(memory.belief, torch.full((4,), 0.25))


def test_the_belief_by_hand():
    memory = StateMemory(TRANSITIONS, SAME, 4.0)
    memory.rule_out(0.0, reading(2))
    # A quarter of a step later 3/4 are still in state 2 and 1/4 has gone on to 3.
    memory.rule_out(1.0, reading(3))
    product = torch.tensor([0.0, 0.0, 0.75 * DOUBT, 0.25 * (1 + DOUBT)])
    assert torch.allclose(memory.belief, (product / product.sum() + ALL[3]) / 2)
    before = memory.belief
    assert memory.rule_out(1.0, reading(0)).all()
    assert torch.allclose(memory.belief, (1 - TRUST_IN_CONTRADICTION) * before + TRUST_IN_CONTRADICTION * ALL[0])


def test_autocast_does_not_round_the_belief():
    plain, cast = memory_of(2, 1, step_seconds=4.0), memory_of(2, 1, step_seconds=4.0)
    plain.rule_out(1.3, reading(3))
    with torch.autocast("cpu", dtype=torch.bfloat16):
        cast.rule_out(1.3, reading(3))
    assert torch.equal(cast.belief, plain.belief)


def test_a_truck_that_was_seen_does_not_vanish_at_once_but_does_in_the_end():
    memory = memory_of(2, 8)
    gone = [bool(memory.rule_out(0.0, reading(0))) for _ in range(12)]
    assert gone[:2] == [True, True] and not any(gone[6:])


def test_what_the_forecast_expects_is_possible():
    memory = memory_of(2, 8)
    assert memory.rule_out(0.0, ALL).tolist() == [True, True, False, True], "no time has passed"
    memory = memory_of(2, 8)
    assert memory.rule_out(1.0, ALL).tolist() == [True, True, False, False], "or, a step later, at its next place"
    assert memory_of(0, 8).rule_out(0.0, ALL).tolist() == [False, False, True, True], "equal boxes are one reading"


@pytest.mark.parametrize("tick", [0.0, 1e-9, 0.4, 1e9])
def test_beliefs_stay_distributions_and_what_is_seen_again_and_again_stays_possible(tick):
    memory = memory_of(2, 3)
    for number in range(300):
        assert not memory.rule_out(number * tick, reading(2, 5)).any()
    assert memory.belief.sum() == pytest.approx(1.0, abs=1e-5) and (memory.belief >= 0).all()


def test_many_states_are_not_ruled_out_for_being_many():
    memory = StateMemory(torch.eye(100), torch.eye(100).bool(), 1.0)
    nothing_learnt = torch.full((4, 100), 0.01)
    assert not memory.rule_out(0.0, nothing_learnt).any() and not memory.rule_out(0.4, nothing_learnt).any()


def test_two_possible_futures_stay_possible():
    memory = StateMemory(TRANSITIONS, SAME, 1.0)
    generator = torch.Generator().manual_seed(0)
    for _ in range(60):  # a view that does not tell 1 from 3, ten samples at a time
        states = torch.where(torch.rand(10, generator=generator) < 0.5, 1, 3)
        assert not memory.rule_out(0.0, ALL[states]).any()


def test_transitions_follow_the_forecast_and_last_states_stay(tiny_evaluation):
    transitions = state_transitions(tiny_evaluation.model, torch.Generator().manual_seed(0))
    assert torch.allclose(transitions.sum(dim=1), torch.ones(4), atol=1e-5)
    assert transitions.argmax(dim=1).tolist() == [1, 1, 3, 3]
    assert torch.equal(transitions[[1, 3]], torch.eye(4)[[1, 3]])


def test_what_was_ruled_out_counts_as_unknown_and_a_hazard_stays_one(tiny_evaluation):
    table, images = tiny_evaluation.table, tiny_evaluation.data.images
    pictures = images[torch.stack([table.views[0, 1], table.views[2, 1]])]  # clear; the truck is there

    def everything(number: int, posterior: torch.Tensor) -> torch.Tensor:
        return torch.ones(len(posterior), dtype=torch.bool)

    rest = (tiny_evaluation.model, pictures, PlannerConfig(), 10, torch.Generator().manual_seed(0))
    clear, truck = decide_from_pictures(*rest, everything)
    assert (clear.hazards, clear.unknown, clear.go) == (0, 10, False)
    assert (truck.hazards, truck.unknown, truck.go) == (10, 0, False)
    assert decide_from_pictures(*rest)[0].go
