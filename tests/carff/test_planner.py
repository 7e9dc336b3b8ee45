import math
from itertools import pairwise

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from carff.planner import Decision, PlannerConfig, decide, exact_go_probability, exact_success
from hashnerf.errors import UserError

RISK, PAPER = PlannerConfig(), PlannerConfig(rule="paper")


def samples(hazards: int, clear: int, unknown: int, config: PlannerConfig) -> Decision:
    kinds = torch.tensor([0] * hazards + [1] * clear + [2] * unknown)
    return decide(kinds == 0, kinds == 2, config)


# --- single decisions ---


def test_the_risk_rule_by_hand():
    # 1 hazard of 10, Beta(0.5, 1.5): p = 1.5 / 12 = 0.125; going costs 0.75, stopping 0.875: go.
    decision = samples(1, 9, 0, RISK)
    assert decision.go
    assert decision.hazard_probability == pytest.approx(0.125)
    assert (decision.cost_of_going, decision.cost_of_stopping) == pytest.approx((0.75, 0.875))
    # 2 of 10: p = 2.5 / 12 = 0.2083; 1.25 against 0.7917: stop.
    assert not samples(2, 8, 0, RISK).go


def test_one_sample_never_suffices_and_two_clear_ones_do():
    # n = 1: p = 0.5 / 3 = 1/6 > 1/7; n = 2: 0.5 / 4 = 1/8 < 1/7.
    assert not samples(0, 1, 0, RISK).go
    assert samples(0, 2, 0, RISK).go


def test_the_paper_rule_goes_only_if_all_are_clear():
    assert samples(0, 10, 0, PAPER).go
    assert not samples(1, 9, 0, PAPER).go
    assert not samples(0, 9, 1, PAPER).go


def test_baselines_do_not_look():
    assert not samples(0, 35, 0, PlannerConfig(rule="always_stop")).go
    assert samples(35, 0, 0, PlannerConfig(rule="always_go")).go


def test_unknown_samples_count_as_hazards_unless_weighted_down():
    assert not samples(0, 8, 2, RISK).go
    assert samples(0, 8, 2, PlannerConfig(unknown_weight=0.0)).go
    # Weight 0.5: two unknown count as one hazard, p = 0.125.
    half = samples(0, 8, 2, PlannerConfig(unknown_weight=0.5))
    assert half.go and half.hazard_probability == pytest.approx(0.125)
    assert samples(0, 9, 1, PlannerConfig(rule="paper", unknown_weight=0.0)).go
    assert (half.samples, half.hazards, half.unknown) == (10, 0, 2)


@given(st.integers(0, 30), st.integers(1, 30), st.sampled_from(["paper", "risk", "always_stop", "always_go"]))
def test_one_hazard_more_never_turns_stop_into_go(hazards, clear, rule):
    config = PlannerConfig(rule=rule)
    assert samples(hazards, clear, 0, config).go >= samples(hazards + 1, clear - 1, 0, config).go


@given(st.floats(0.1, 100), st.floats(0.1, 100), st.integers(0, 20), st.integers(0, 20))
def test_the_risk_rule_picks_the_cheaper_action(collision, stop, hazards, clear):
    config = PlannerConfig(collision_cost=collision, stop_cost=stop)
    if hazards + clear:
        decision = samples(hazards, clear, 0, config)
        cheaper, dearer = decision.cost_of_going, decision.cost_of_stopping
        if not math.isclose(cheaper, dearer, rel_tol=1e-9):
            assert decision.go == (cheaper < dearer)


# --- exact success of the rules ---


def slow_success(config: PlannerConfig, n: int, p: float, safe_to_go: bool) -> float:
    """The definition: every sequence of n outcomes, decided on its own."""
    total = 0.0
    for code in range(2**n):
        hazard = torch.tensor([bool(code >> i & 1) for i in range(n)])
        go = decide(hazard, torch.zeros(n, dtype=torch.bool), config).go
        k = int(hazard.sum())
        total += p**k * (1 - p) ** (n - k) * (go == safe_to_go)
    return total


@pytest.mark.parametrize("config", [RISK, PAPER])
@pytest.mark.parametrize("n", [1, 2, 9])
def test_exact_success_matches_enumeration(config, n):
    for p, safe in ((0.4, False), (0.05, True)):
        assert exact_success(config, n, p, safe) == pytest.approx(slow_success(config, n, p, safe), abs=1e-12)


def test_exact_success_of_the_paper_rule_is_a_power():
    for n in (2, 10, 35):
        assert exact_success(PAPER, n, 0.5, False) == pytest.approx(1 - 0.5**n)
        assert exact_success(PAPER, n, 0.005, True) == pytest.approx(0.995**n)


def test_exact_success_of_the_risk_rule_by_hand():
    # n = 10 goes with at most 1 hazard. p = 1/2: stops with 1 - 11/1024 = 0.989258;
    # p = 0.005: goes with 0.995^10 + 10 * 0.005 * 0.995^9 = 0.998913.
    assert exact_success(RISK, 10, 0.5, False) == pytest.approx(1 - 11 / 1024)
    assert exact_success(RISK, 10, 0.005, True) == pytest.approx(0.995**10 + 0.05 * 0.995**9)


def test_ten_samples_are_decided_as_well_as_any_rule_on_counts_can():
    # The worse of "hidden, p = 1/2" and "clear, p = 0.005" at n = 10, for every largest allowed number of hazards.
    def worse(allowed: int) -> float:
        def below(p: float) -> float:
            return math.fsum(math.comb(10, k) * p**k * (1 - p) ** (10 - k) for k in range(allowed + 1))

        return min(1 - below(0.5), below(0.005))

    best = max(worse(allowed) for allowed in range(10))
    assert min(exact_success(RISK, 10, 0.5, False), exact_success(RISK, 10, 0.005, True)) == pytest.approx(best)
    assert best == pytest.approx(0.989258, abs=1e-6)
    for n in range(11, 36):
        assert exact_success(RISK, n, 0.5, False) > 0.99 and exact_success(RISK, n, 0.005, True) > 0.99


@pytest.mark.parametrize("p", [0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65])
def test_more_samples_never_make_a_hidden_hazard_more_dangerous(p):
    at_ten = exact_success(RISK, 10, p, False)
    assert all(exact_success(RISK, n, p, False) >= at_ten for n in range(10, 81))
    assert exact_success(RISK, 35, p, False) > at_ten > exact_success(RISK, 2, p, False)


@pytest.mark.parametrize("p", [0.0005, 0.001, 0.005, 0.01])
def test_more_samples_do_not_make_clear_scenes_stop(p):
    # Between two values of n at which one hazard more is allowed, the success must sag a little; it stays above 99 %,
    # and 35 samples beat 10, which beat 2. The paper's rule falls all the way.
    assert min(exact_success(RISK, n, p, True) for n in range(10, 81)) > 0.99
    risk, paper = ([exact_success(rule, n, p, True) for n in (2, 10, 35)] for rule in (RISK, PAPER))
    assert risk[0] < risk[1] < risk[2]
    assert paper[0] > paper[1] > paper[2]


def test_success_follows_the_probability_of_a_hazard():
    going = [exact_go_probability(RISK, 20, p / 20) for p in range(21)]
    assert going[0] == 1.0 and going[-1] == 0.0
    assert all(first >= second for first, second in pairwise(going))


# --- errors ---


def test_nothing_to_decide_from_is_refused():
    none = torch.zeros(0, dtype=torch.bool)
    with pytest.raises(UserError, match="at least one"):
        decide(none, none, RISK)


def test_a_sample_cannot_be_hazard_and_unknown():
    yes = torch.ones(2, dtype=torch.bool)
    with pytest.raises(UserError, match="at once"):
        decide(yes, yes, RISK)


@pytest.mark.parametrize(
    "change",
    [
        {"collision_cost": 0.0},
        {"stop_cost": -1.0},
        {"prior_hazard": math.inf},
        {"prior_clear": math.nan},
        {"unknown_weight": 2.0},
    ],
)
def test_impossible_settings_are_refused_by_name(change):
    with pytest.raises(UserError, match=rf"planner\.{next(iter(change))}"):
        PlannerConfig(**change)


@pytest.mark.parametrize("question", [(0, 0.5), (10, 1.5), (10, -0.1), (10, math.nan)])
def test_impossible_questions_are_refused(question):
    with pytest.raises(UserError, match="hazard probability"):
        exact_go_probability(RISK, *question)
