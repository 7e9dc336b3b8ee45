"""Latents of a state: weights within a state, posterior draws under the Bernoulli mix, moments."""

import torch

from carff.latent_bank import build_bank


def bank(distinctness):
    mean = torch.tensor([[0.0], [10.0], [5.0], [7.0]])
    logvar = torch.full((4, 1), -4.0)
    return build_bank(mean, logvar, torch.tensor([0, 0, 1, 1]), torch.tensor(distinctness), torch.Generator())


def test_weights_sum_to_one_within_a_state_and_fall_back_to_equal():
    assert torch.allclose(bank([0.3, 0.1, 0.0, 0.0]).weight, torch.tensor([0.75, 0.25, 0.5, 0.5]))


def test_a_view_without_distinctness_is_never_drawn():
    draws = bank([1.0, 0.0, 1.0, 1.0]).draw(torch.zeros(500, dtype=torch.int64), 1.0, torch.Generator().manual_seed(0))
    assert draws.max() < 5.0


def test_every_mix_draws_from_the_posterior():
    # One view only: mean 0, standard deviation e^-2 = 0.1353, whatever the share of fresh samples.
    spreads = []
    for seed in range(2000):
        generator = torch.Generator().manual_seed(seed)
        alone = build_bank(torch.zeros(1, 1), torch.full((1, 1), -4.0), torch.tensor([0]), torch.ones(1), generator)
        spreads.append(alone.draw(torch.tensor([0]), 0.5, generator))
    # Standard error of a standard deviation over 2,000 draws: 0.1353 / sqrt(4000) = 0.0021; four of them.
    assert abs(torch.cat(spreads).std().item() - 0.1353) < 0.0086


def test_share_zero_repeats_the_fixed_sample():
    some = bank([1.0, 0.0, 1.0, 0.0])
    draws = some.draw(torch.tensor([0, 1, 0]), 0.0, torch.Generator())
    assert torch.equal(draws, some.fixed[[0, 2, 0]])


def test_state_beliefs_are_the_same_under_autocast():
    some = bank([0.3, 0.1, 0.7, 0.2])
    plain = some.state_beliefs()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        cast = some.state_beliefs()
    assert torch.equal(cast.mean, plain.mean) and torch.equal(cast.logvar, plain.logvar)


def test_state_belief_has_the_mixture_moments():
    # Views at 0 and 10, half each, variance e^-4 each: mean 5, variance 25 + e^-4.
    belief = bank([1.0, 1.0, 1.0, 1.0]).state_beliefs()
    assert torch.allclose(belief.mean[0], torch.tensor([5.0]))
    assert torch.allclose(belief.logvar[0].exp(), torch.tensor([25 + torch.e**-4]))
