"""Skipping bad steps: counted, forgotten after a good one, given up after eleven in a row."""

import pytest
import torch
from torch.nn.utils import clip_grad_norm_, get_total_norm

from hashnerf.errors import UserError
from hashnerf.finite_steps import FiniteSteps


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), float("-inf")])
def test_n133_a_bad_term_is_refused_and_counted(numeric_row, bad):
    guard = FiniteSteps()
    assert guard.accepts(0, {"loss": torch.tensor(1.0), "gradient": 2.0})
    assert not guard.accepts(1, {"loss": torch.tensor(bad), "gradient": 2.0})
    assert guard.accepts(2, {"loss": 1.0})
    numeric_row("N133", f"a loss of {bad}: not counted", abs(guard.skipped - 1) + guard.in_a_row)


def test_n133_eleven_in_a_row_name_the_term_and_the_step(numeric_row):
    guard = FiniteSteps()
    for step in range(10):
        assert not guard.accepts(step, {"error": float("nan"), "kl": 1.0})
    with pytest.raises(UserError, match="step 10: error not finite") as refused:
        guard.accepts(10, {"error": float("nan"), "kl": 1.0})
    numeric_row("N133", "eleven bad steps in a row: went on", refused is None)


@pytest.mark.parametrize("clipped", [True, False])
@pytest.mark.parametrize("bad", [float("inf"), float("-inf"), float("nan"), 1e30, 1.0, 0.0])
def test_n134_no_gradient_whatever_its_size_spoils_a_weight(numeric_row, bad, clipped):
    """The order of every training loop: norm (clipped or not), guard, step."""
    weights = [torch.ones(3, requires_grad=True), torch.ones(2, requires_grad=True)]
    optimizer, guard = torch.optim.Adam(weights, lr=1e-3), FiniteSteps()
    weights[0].grad, weights[1].grad = torch.tensor([bad, 0.0, 0.0]), torch.zeros(2)
    norm = clip_grad_norm_(weights, 1.0) if clipped else get_total_norm([one.grad for one in weights])
    if guard.accepts(0, {"gradient": norm}):
        optimizer.step()
    spoilt = sum(int((~one.isfinite()).sum()) for one in weights)
    still = weights[0].tolist() == [1, 1, 1] and weights[1].tolist() == [1, 1]
    # the square of 1e30 is infinite in float32: such a step is skipped, too
    numeric_row("N134", f"a gradient of {bad:g}, clipped: {clipped}; spoilt weights", spoilt)
    assert still == (bad != 1.0) and guard.skipped == (0 if abs(bad) <= 1 else 1)
