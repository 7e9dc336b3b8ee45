"""Roll-out with a forecast network and densities that are known exactly."""

import torch
from torch import nn

from carff.beliefs import Belief
from carff.forecast import roll_out
from carff.mixtures import GaussianMixture
from carff.probe import UNKNOWN, Probe, ProbeConfig, build_candidates
from carff.states import ActorBox

BOXES = [ActorBox("truck", (10.0 * i, 0.0, 1.0), (2.0, 2.0, 2.0), 0.0) for i in range(3)]


class NextOnALine(nn.Module):
    """From latent x (state x) the next is x + 1 for sure; from 0 it is 1 or 2, one half each."""

    def __init__(self):
        super().__init__()
        self.seen = []

    def forward(self, mean, logvar):
        self.seen.append(logvar)
        first = mean + 1
        second = torch.where(mean.abs() < 0.5, mean + 2, mean + 1)
        means = torch.stack([first, second], dim=1)
        return GaussianMixture(torch.full((len(mean), 2), 0.5).log(), means, torch.full_like(means, -6.0))


def density(points, latents):
    """The box that the latent's whole number names is full; half-way between two numbers there is nothing."""
    rows = []
    for latent in latents[:, 0]:
        near = torch.tensor(BOXES[int(latent.round().clamp(0, 2))].center)
        full = (latent - latent.round()).abs() < 0.25
        rows.append(((points - near).norm(dim=1) < 3).float() * 20 * full)
    return torch.stack(rows)


def probe() -> Probe:
    candidates = build_candidates([[box] for box in BOXES], ProbeConfig(columns=(2, 2), levels=3))
    return Probe(candidates, torch.ones(3), torch.full((3,), 0.5), torch.full((3,), 0.5), 0.6)


def start(value: float) -> Belief:
    return Belief(torch.tensor([[value]]), torch.tensor([[-4.0]]))


def states_as_beliefs() -> Belief:
    return Belief(torch.arange(3.0)[:, None], torch.full((3, 1), -9.0))


def test_samples_find_both_futures_and_go_on_from_their_own_state():
    mdn = NextOnALine()
    forecast = roll_out(
        start(0.0), mdn, probe(), density, states_as_beliefs(), 200, 2, torch.Generator().manual_seed(0)
    )
    first = torch.bincount(forecast.states[0], minlength=3)
    # 200 fair draws: mean 100, standard deviation 7.1; four of them.
    assert first[0] == 0 and abs(int(first[1]) - 100) < 29
    assert (forecast.states[1][forecast.states[0] == 1] == 2).all()
    # The second step reads the belief of the probed state, not the sample.
    assert torch.equal(mdn.seen[1], torch.full((200, 1), -9.0))


def test_an_unknown_sample_keeps_its_place_and_spread():
    mdn = NextOnALine()
    forecast = roll_out(start(0.5), mdn, probe(), density, states_as_beliefs(), 5, 2, torch.Generator().manual_seed(0))
    assert (forecast.states[0] == UNKNOWN).all()
    # Both components stand at 1.5 with log-sigma -6, so the variance is e^-12.
    assert torch.allclose(mdn.seen[1], torch.full((5, 1), -12.0), atol=1e-3)
    assert (forecast.latents[1] - 2.5).abs().max() < 0.1
