"""Blocked networks against plain layers, and their bank form against one condition at a time."""

import pytest
import torch

from hashnerf import mlp
from hashnerf.mlp import MLP


def plain(network: MLP, x):
    """The same network as ordinary matrix products."""
    for weight in network.weights[:-1]:
        x = torch.relu(x @ weight.T)
    return x @ network.weights[-1].T


@pytest.mark.parametrize("rows", [0, 1, 7, 8, 9, 30])
@pytest.mark.parametrize("layers", [1, 2])
def test_values_and_gradients_against_plain_layers(monkeypatch, rows, layers):
    monkeypatch.setattr(mlp, "BLOCK", 8)  # several blocks and a remainder
    network = MLP(5, 16, layers, 3).double()
    first, second = torch.randn(rows, 2).double().requires_grad_(), torch.randn(rows, 3).double().requires_grad_()
    leaves = [first, second, *network.parameters()]
    out = network([first, second])
    pull = torch.randn_like(out)
    ours = torch.autograd.grad(out, leaves, pull)
    slow = plain(network, torch.cat([first, second], dim=1))
    assert torch.allclose(out, slow)
    for a, b in zip(ours, torch.autograd.grad(slow, leaves, pull)):
        assert torch.allclose(a, b)


def test_only_parts_that_ask_get_a_gradient():
    network = MLP(5, 8, 1, 2)
    fixed, learnt = torch.randn(4, 2), torch.randn(4, 3, requires_grad=True)
    network([fixed, learnt]).sum().backward()
    assert fixed.grad is None
    assert learnt.grad.abs().sum() > 0


def test_gradient_check():
    network = MLP(4, 6, 2, 2).double()
    x = torch.randn(5, 4).double().requires_grad_()
    weights = [weight.detach().requires_grad_() for weight in network.weights]

    def run(x, *weights):
        names = {f"weights.{i}": weight for i, weight in enumerate(weights)}
        return torch.func.functional_call(network, names, ([x],))

    assert torch.autograd.gradcheck(run, (x, *weights))


@pytest.fixture
def bfloat16_units(monkeypatch):
    monkeypatch.setattr(mlp, "multiplies_bfloat16", lambda device_type: True)


def test_without_units_for_bfloat16_products_are_float32(monkeypatch):
    monkeypatch.setattr(mlp, "multiplies_bfloat16", lambda device_type: False)
    exact, low = MLP(6, 16, 2, 3), MLP(6, 16, 2, 3, low_precision=True)
    low.load_state_dict(exact.state_dict())
    x = torch.randn(9, 6)
    assert torch.equal(low([x]), exact([x]))


def test_bfloat16_is_close_and_returns_float32(bfloat16_units):
    exact, low = MLP(24, 64, 2, 3), MLP(24, 64, 2, 3, low_precision=True)
    low.load_state_dict(exact.state_dict())
    x = torch.randn(5000, 24)
    assert low([x]).dtype == torch.float32
    error = (low([x]) - exact([x])).norm() / exact([x]).norm()
    assert 1e-4 < error < 2e-2
    pull = torch.randn(5000, 3)
    ours, truth = (torch.autograd.grad(network([x]), list(network.weights), pull) for network in (low, exact))
    for a, b in zip(ours, truth):
        assert a.dtype == torch.float32
        assert (a - b).norm() / b.norm() < 0.1


def test_n131_weights_multiplied_in_half_precision_move_by_small_steps(numeric_row, bfloat16_units):
    network = MLP(4, 8, 0, 2, low_precision=True)  # of one layer: its gradient stays the same
    for weight in network.weights:
        torch.nn.init.ones_(weight)
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-3)
    for _ in range(100):
        optimizer.zero_grad()
        network([torch.ones(16, 4)]).sum().backward()
        optimizer.step()
    off = max(float((weight - 0.9).detach().abs().max()) for weight in network.weights)
    numeric_row("N131", "100 steps of Adam at 1e-3 from 1: off 0.9", off, 1e-3)


@pytest.mark.parametrize("low", [False, True])
def test_an_outer_autocast_changes_nothing(low, bfloat16_units):
    network = MLP(6, 16, 2, 3, low)
    x = torch.randn(9, 6, requires_grad=True)
    learnt = [x, *network.weights]
    plain = network([x])
    slopes = torch.autograd.grad(plain.sum(), learnt)
    with torch.autocast("cpu", dtype=torch.float16):
        inside = network([x])
        inside_slopes = torch.autograd.grad(inside.sum(), learnt)
    assert torch.equal(inside, plain)
    assert all(torch.equal(a, b) for a, b in zip(inside_slopes, slopes))


@pytest.mark.parametrize("bank", [None, 1, 5])
def test_the_bank_equals_one_condition_at_a_time(bank):
    network = MLP(4 + (3 if bank else 0), 16, 2, 5)
    x = torch.randn(11, 4)
    conditions = torch.randn(bank, 3) if bank else None
    ours = network.first_output_bank(x, conditions)
    rows = [network([x])] if bank is None else [network([x, row.expand(11, 3)]) for row in conditions]
    assert torch.allclose(ours, torch.stack([row[:, 0] for row in rows]), atol=1e-5)


@pytest.mark.parametrize("rows", [1, 511, 512, 700, 4097])
def test_rows_that_fill_a_half_precision_block_change_nothing(rows, bfloat16_units):
    torch.manual_seed(0)
    network, x = MLP(6, 16, 2, 3, low_precision=True), torch.randn(rows, 6)
    whole = torch.nn.functional.pad(x, (0, 0, 0, -rows % mlp.GRAIN))
    (padded := network([whole])).square().sum().backward()
    expected = [weight.grad.clone() for weight in network.weights]
    network.zero_grad()
    out = network([x])
    out.square().sum().backward()
    assert torch.equal(out, padded[:rows])
    for weight, gradient in zip(network.weights, expected):
        assert torch.allclose(weight.grad, gradient, rtol=1e-5, atol=1e-6)
    slope = torch.autograd.grad(network([x.requires_grad_()]).sum(), x)[0]
    assert slope.shape == x.shape and slope.isfinite().all()
