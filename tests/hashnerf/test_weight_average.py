"""The weight average: a true average from the first step, in float32, restorable."""

import pytest
import torch
from torch import nn

from hashnerf.errors import UserError
from hashnerf.weight_average import WeightAverage


def module(value=1.0, dtype=torch.float32):
    linear = nn.Linear(2, 2, bias=False, dtype=dtype)
    nn.init.constant_(linear.weight, value)
    return linear


@pytest.mark.parametrize("decay", [0.0, 0.5, 0.95, 0.9999])
def test_n136_constant_weights_are_their_own_average(numeric_row, decay):
    model = module(3.7)
    average = WeightAverage(model, decay)
    worst = 0.0
    for _ in range(10):
        average.update()
        worst = max(worst, float((average.averages[0] - 3.7).abs().max()))
    numeric_row("N136", f"constant weights, decay {decay:g}, 10 steps", worst, 1e-6)


def test_n136_equals_the_weighted_sum(numeric_row):
    model, decay = module(0.0), 0.8
    average = WeightAverage(model, decay)
    values = [5.0, -1.0, 2.0, 7.0]
    for value in values:
        nn.init.constant_(model.weight, value)
        average.update()
    # sum of 0.8^age * value over sum of 0.8^age
    weights = [decay**age for age in (3, 2, 1, 0)]
    expected = sum(w * v for w, v in zip(weights, values)) / sum(weights)
    off = abs(average.averages[0][0, 0].item() - expected)
    numeric_row("N136", "weights 0, then 5, -1, 2, 7, decay 0.8: off the weighted mean of the four", off, 1e-6)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_n137_half_weights_do_not_stall(numeric_row, dtype):
    model = module(0.0, dtype)
    average = WeightAverage(model, 0.999)
    average.update()
    nn.init.constant_(model.weight, 1.0)
    for _ in range(20_000):
        average.update()
    assert average.averages[0].dtype == torch.float32
    numeric_row("N137", f"weights in {dtype}, 20,000 steps: missing", 1 - float(average.averages[0].min()), 1e-3)


def test_applied_swaps_and_restores():
    model = module(1.0)
    average = WeightAverage(model, 0.5)
    with average.applied():
        assert (model.weight == 1).all(), "nothing was averaged yet"
    average.update()
    nn.init.constant_(model.weight, 3.0)
    average.update()  # (1 * 0.5 + 3) / 1.5
    with pytest.raises(RuntimeError), average.applied():
        assert model.weight[0, 0].item() == pytest.approx(7 / 3, rel=1e-6)
        raise RuntimeError
    assert (model.weight == 3).all()


def test_state_continues_exactly():
    one, two = module(1.0), module(9.0)
    first, second = WeightAverage(one, 0.9), WeightAverage(two, 0.9)
    first.update()
    second.load_state_dict(first.state_dict())
    for model, average in ((one, first), (two, second)):
        nn.init.constant_(model.weight, 4.0)
        average.update()
    assert torch.equal(first.averages[0], second.averages[0])
    assert second.updates == 2


@pytest.mark.parametrize("decay", [-0.1, 1.0])
def test_impossible_decays_are_refused(decay):
    with pytest.raises(UserError, match="decay"):
        WeightAverage(module(), decay)
