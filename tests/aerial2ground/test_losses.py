"""Losses by hand, and a network's own idea of its error."""

import math

import pytest
import torch

from aerial2ground.losses import SMALLEST, answers_of, deviations, laplace_loss, log_widths, loss_of


def test_a_pair_by_hand():
    # 3-4-5 apart with width 2: 5, and a tenth of 5 / 2 + 2 log 2; a second pair exact, of width 1: 0
    answers = torch.tensor([[3.0, 4.0, 1.0, 0.0, 0.0, 0.0]])
    answers[0, 4] = 6 * math.atanh(math.log(2) / 6)
    targets = torch.tensor([[0.0, 0.0, 1.0, 0.0]])
    assert float(laplace_loss(answers, targets)) == pytest.approx(5 + 0.1 * (2.5 + 2 * math.log(2)), abs=1e-3)


def test_it_is_the_logarithm_of_a_density():
    b = 0.7
    r = torch.linspace(1e-4, 30, 200_001, dtype=torch.float64)
    density = torch.exp(-r / b) / (2 * math.pi * b**2)
    ring = 2 * math.pi * r
    assert float(torch.trapezoid(density * ring, r)) == pytest.approx(1.0, abs=1e-4)
    # of one of both numbers: half of the mean square distance
    variance = float(torch.trapezoid(density * ring * r**2, r)) / 2
    raw = torch.tensor([[6 * math.atanh(math.log(b) / 6)]])
    assert float(deviations(raw)) == pytest.approx(math.sqrt(variance), rel=1e-3)


def test_the_best_width_is_half_the_mean_distance():
    generator = torch.Generator().manual_seed(0)
    targets = torch.randn(4000, 2, generator=generator) * 0.3
    raw = torch.zeros(1, 1, requires_grad=True)
    optimizer = torch.optim.Adam([raw], lr=0.05)
    for _ in range(300):
        optimizer.zero_grad()
        answers = torch.cat([torch.zeros(4000, 2), raw.expand(4000, 1)], dim=1)
        laplace_loss(answers, targets).backward()
        optimizer.step()
    expected = float(targets.norm(dim=1).mean()) / 2
    assert float(log_widths(raw.detach()).exp()) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("raw", [-1e30, -100.0, 0.0, 100.0, 1e30])
@pytest.mark.parametrize("apart", [0.0, 1e-20, 1.0, 1e4])
def test_values_and_slopes_stay_finite(raw, apart):
    answers = torch.tensor([[apart, 0.0, raw]], requires_grad=True)
    loss = laplace_loss(answers, torch.zeros(1, 2))
    loss.backward()
    assert loss.isfinite() and answers.grad.isfinite().all()
    assert 0 < float(deviations(torch.tensor([[raw]]))) < math.inf


def test_how_sure_a_network_is_does_not_change_what_pulls_at_its_answer():
    pulls = []
    for raw in (-3.0, 0.0, 3.0):
        answers = torch.tensor([[3.0, 4.0, raw]], requires_grad=True)
        laplace_loss(answers, torch.zeros(1, 2)).backward()
        pulls.append(answers.grad[0, :2].tolist())
    assert pulls == [pytest.approx([0.6, 0.8])] * 3


def test_an_exact_answer_is_not_pulled_anywhere():
    answers = torch.tensor([[0.5, 0.5, 0.0]], requires_grad=True)
    laplace_loss(answers, torch.full((1, 2), 0.5)).backward()
    assert answers.grad[0, :2].tolist() == [0.0, 0.0]
    assert SMALLEST < 1e-3


def test_names_and_numbers_of_answers():
    assert [answers_of(name, 4) for name in ("l1", "l2", "laplace")] == [4, 4, 6]
    one, other = torch.tensor([[1.0, 3.0]]), torch.zeros(1, 2)
    assert float(loss_of("l1")(one, other)) == 2.0 and float(loss_of("l2")(one, other)) == 5.0
    assert loss_of("laplace") is laplace_loss
