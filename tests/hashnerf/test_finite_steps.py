"""Skipping bad steps: counted, forgotten after a good one, given up after eleven in a row."""

import pytest
import torch

from hashnerf.errors import UserError
from hashnerf.finite_steps import FiniteSteps


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), float("-inf")])
def test_a_bad_term_is_refused_and_counted(bad):
    guard = FiniteSteps()
    assert guard.accepts(0, {"loss": torch.tensor(1.0), "gradient": 2.0})
    assert not guard.accepts(1, {"loss": torch.tensor(bad), "gradient": 2.0})
    assert guard.accepts(2, {"loss": 1.0})
    assert (guard.skipped, guard.in_a_row) == (1, 0)


def test_eleven_in_a_row_name_the_term_and_the_step():
    guard = FiniteSteps()
    for step in range(10):
        assert not guard.accepts(step, {"error": float("nan"), "kl": 1.0})
    with pytest.raises(UserError, match="step 10: error not finite"):
        guard.accepts(10, {"error": float("nan"), "kl": 1.0})
