import json
import math
from pathlib import Path

import pytest
import torch

from carff.beliefs import Belief
from carff.mdn import MDN
from carff.mdn_training import Annealing, MdnConfig, MixtureHealth, build_mdn, mixture_health, train_mdn
from carff.mixtures import GaussianMixture, negative_log_likelihood
from carff.transitions import TransitionBatch, TransitionConfig, TransitionSampler, ViewBeliefs
from hashnerf.errors import UserError

SMALL = {"width": 32, "steps": 150, "batch_size": 64, "save_every": 1000}


def circle(cameras: int) -> torch.Tensor:
    angle = torch.arange(cameras) * 2 * math.pi / cameras
    poses = torch.eye(4).repeat(cameras, 1, 1)
    poses[:, 0, 3], poses[:, 1, 3] = 10 * angle.cos(), 10 * angle.sin()
    return poses


def one_step(means: tuple[float, float], seed: int) -> TransitionSampler:
    """Two branches that look alike now (mean 0); then branch 0 is at the first mean and branch 1 at the second."""
    states = torch.tensor([0.0, means[0], 0.0, means[1]])[:, None, None].expand(4, 3, 1)
    views = ViewBeliefs(states, torch.zeros(4, 3, 1), torch.ones(4, 3, dtype=torch.bool))
    return TransitionSampler(views, torch.tensor([1, -1, 3, -1]), circle(3), TransitionConfig(), seed)


def two_branches(seed: int, cameras: int = 30) -> tuple[TransitionSampler, torch.Tensor, torch.Tensor]:
    """Two branches of three steps in eight dimensions; a third of the views cannot tell them apart.

    Returns the sampler, the clusters [branch, step, d] and which (step, camera) are ambiguous.
    """
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(shape, generator=generator)

    clusters = normal(2, 3, 8)
    ambiguous = torch.rand(3, cameras, generator=generator) < 0.35
    clear = clusters[:, :, None] + 0.1 * normal(2, 3, cameras, 8)
    middle = clusters.mean(dim=0)[:, None] + 0.1 * normal(3, cameras, 8)
    means = torch.where(ambiguous[None, :, :, None], middle[None], clear)
    sigmas = torch.where(ambiguous[None, :, :, None], 0.3, 0.1 + 0.2 * torch.rand(means.shape, generator=generator))
    views = ViewBeliefs(means.flatten(0, 1), 2 * sigmas.log().flatten(0, 1), torch.ones(6, cameras, dtype=torch.bool))
    sampler = TransitionSampler(views, torch.tensor([1, 2, -1, 4, 5, -1]), circle(cameras), TransitionConfig(), seed)
    return sampler, clusters, ambiguous


def trained(sampler: TransitionSampler, folder: Path, **changes) -> MDN:
    torch.manual_seed(sampler.seed)
    config = MdnConfig(**{**SMALL, **changes})
    mdn = build_mdn(config, sampler.beliefs.means.shape[-1])
    train_mdn(config, mdn, sampler, folder, {})
    return mdn.eval()


# --- both modes are found ---


def test_n76_two_modes_are_recalled_with_their_weights_for_almost_every_seed(tmp_path, numeric_row):
    recalled = 0
    for seed in range(20):
        mdn = trained(one_step((-3.0, 3.0), seed), tmp_path / str(seed))
        with torch.no_grad():
            mixture = mdn(torch.zeros(1, 1), torch.zeros(1, 1))
        means, weights = mixture.means[0, :, 0].sort(), mixture.log_weights[0].exp()
        near = (means.values - torch.tensor([-3.0, 3.0])).abs().max() < 0.5
        recalled += bool(near and (weights - 0.5).abs().max() < 0.1)
    numeric_row("N76", "modes at -3 and 3: seeds of 20 that miss one or its weight", 20 - recalled, 1)


def test_n76_a_second_component_costs_nothing_where_there_is_one_mode(tmp_path, numeric_row):
    sampler = one_step((0.0, 0.0), 0)
    values = torch.randn(1, 20_000, 1, generator=torch.Generator().manual_seed(0))
    losses = []
    for components in (1, 2):
        mdn = trained(sampler, tmp_path / str(components), components=components)
        with torch.no_grad():
            losses.append(float(negative_log_likelihood(mdn(torch.zeros(1, 1), torch.zeros(1, 1)), values)))
    numeric_row("N76", "one mode: nats between two components and one", abs(losses[1] - losses[0]), 0.05)
    assert losses[0] == pytest.approx(0.5 * math.log(2 * math.pi * math.e), abs=0.05)


@pytest.mark.parametrize("components", [2, 4])
def test_occluded_views_predict_both_branches_and_clear_views_their_own(tmp_path, components):
    sampler, clusters, ambiguous = two_branches(0)
    mdn = trained(sampler, tmp_path / "run", components=components, width=64, steps=400, batch_size=128)
    state, camera = sampler.sources.T
    branch, step = state // 3, state % 3
    source = sampler.beliefs.at(state, camera)
    with torch.no_grad():
        samples = mdn(source.mean, source.logvar).sample(2000, torch.Generator().manual_seed(0))
    nearest = torch.cdist(samples.flatten(0, 1), clusters.flatten(0, 1)).argmin(dim=1).view(len(state), -1)
    right_step = (nearest % 3 == step[:, None] + 1).double().mean(dim=1)
    own_branch = ((nearest // 3 == branch[:, None]) & (nearest % 3 == step[:, None] + 1)).double().mean(dim=1)
    hidden = ambiguous[step, camera]
    assert right_step.min() > 0.95
    assert own_branch[~hidden].mean() > 0.98
    assert 0.45 < own_branch[hidden & (branch == 0)].mean() < 0.55
    # View by view, allowing four standard errors of 2000 samples beside the 0.05.
    assert (own_branch[hidden] - 0.5).abs().quantile(0.9) < 0.05 + 4 * 0.5 / math.sqrt(2000)


def test_likelihood_alone_settles_for_one_broad_gaussian(tmp_path):
    """The failure that the splitting phase is there for; if this passes without it, it can go."""
    generator = torch.Generator().manual_seed(0)
    # Ten steps far apart; the branches differ by 2.4 in one of four dimensions, at three times the posteriors' sigma.
    path = 3 * torch.randn(5, 4, generator=generator)
    offset = torch.tensor([1.2, 0.0, 0.0, 0.0])
    means = torch.stack([path - offset, path + offset])[:, :, None] + 0.1 * torch.randn(1, 5, 6, 4, generator=generator)
    means[:, ::2] = path[None, ::2, None]  # every other step is ambiguous from every camera
    views = ViewBeliefs(
        means.flatten(0, 1), torch.full((10, 6, 4), 2 * math.log(0.4)), torch.ones(10, 6, dtype=torch.bool)
    )
    successor = torch.tensor([1, 2, 3, 4, -1, 6, 7, 8, 9, -1])
    sampler = TransitionSampler(views, successor, circle(6), TransitionConfig(), 0)
    modes = {}
    for share in (0.0, 0.6):
        mdn = trained(sampler, tmp_path / str(share), width=64, steps=300, split_share=share)
        modes[share] = mixture_health(mdn, sampler).several_modes
    assert modes[0.0] < 0.3 < 0.45 < modes[0.6]


# --- the run ---


def test_k06_an_interrupted_training_ends_exactly_like_an_uninterrupted_one(tmp_path, numeric_row):
    class Interrupted(TransitionSampler):
        def batch(self, step: int, size: int) -> TransitionBatch:
            if step == 25 and not (tmp_path / "stopped").exists():
                (tmp_path / "stopped").touch()
                raise KeyboardInterrupt
            return super().batch(step, size)

    whole = trained(one_step((-3.0, 3.0), 1), tmp_path / "whole", steps=40, save_every=10)
    sampler = one_step((-3.0, 3.0), 1)
    sampler.__class__ = Interrupted
    with pytest.raises(KeyboardInterrupt):
        trained(sampler, tmp_path / "parts", steps=40, save_every=10)
    resumed = trained(sampler, tmp_path / "parts", steps=40, save_every=10)
    different = [
        name for name, value in whole.state_dict().items() if not torch.equal(value, resumed.state_dict()[name])
    ]
    numeric_row("K06", "forecast, 40 steps, stopped at 25: weights that differ", len(different))


def test_the_metrics_end_with_the_health_of_the_mixture(tmp_path):
    sampler = one_step((-3.0, 3.0), 1)
    mdn = trained(sampler, tmp_path / "run", steps=10)
    lines = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines] == [0, 9, 10]
    assert {name: lines[-1][name] for name in ("nll", "several_modes")} == {
        "nll": mixture_health(mdn, sampler).nll,
        "several_modes": mixture_health(mdn, sampler).several_modes,
    }


def test_k26_the_seed_decides(tmp_path, numeric_row):
    first = trained(one_step((-3.0, 3.0), 1), tmp_path / "a", steps=10)
    again = trained(one_step((-3.0, 3.0), 1), tmp_path / "b", steps=10)
    other = trained(one_step((-3.0, 3.0), 2), tmp_path / "c", steps=10)
    weight = "trunk.0.weight"
    changed = (first.state_dict()[weight] - again.state_dict()[weight]).abs().max()
    numeric_row("K26", "a forecast trained twice from one seed: largest difference of a weight", float(changed))
    assert not torch.equal(first.state_dict()[weight], other.state_dict()[weight])


def test_k21_a_spike_of_the_loss_moves_no_weight_far(tmp_path, numeric_row):
    """Nothing is rolled back, for nothing is lost: the gradient is clipped, and Adam's step is bounded by its rate."""
    weights = []

    class Spiked(TransitionSampler):
        def batch(self, step: int, size: int) -> TransitionBatch:
            batch = super().batch(step, size)
            if step in (100, 101):
                weights.append(torch.cat([value.detach().flatten().clone() for value in mdn.parameters()]))
            return TransitionBatch(batch.source, batch.target, batch.samples + 4e3) if step == 100 else batch

    config = MdnConfig(**SMALL, log_every=1)
    sampler = one_step((-3.0, 3.0), 1)
    sampler.__class__ = Spiked
    torch.manual_seed(1)
    mdn = build_mdn(config, 1)
    train_mdn(config, mdn, sampler, tmp_path / "run", {})
    lines = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert lines[100]["nll"] > 1e6 * lines[99]["nll"] > 0 and lines[-2]["skipped"] == 0
    # (1 - 0.9) / sqrt(1 - 0.999) of the rate: as far as Adam goes when one gradient exceeds all before it
    numeric_row(
        "K21",
        "loss 1e6 times as high: change of a weight in rates",
        float((weights[1] - weights[0]).abs().max()) / config.lr,
        3.2,
    )
    usual = mixture_health(trained(one_step((-3.0, 3.0), 1), tmp_path / "usual"), sampler).nll
    numeric_row("K21", "the same: nats lost by the end of training", mixture_health(mdn, sampler).nll - usual, 0.05)


# --- annealing ---


def pairs(target_means: torch.Tensor, logvar: float = 0.0) -> TransitionBatch:
    belief = Belief(target_means, torch.full_like(target_means, logvar))
    return TransitionBatch(belief, belief, target_means[:, None])


def test_the_temperature_falls_from_above_the_spread_to_the_width_of_a_posterior():
    # Targets at +-10 in the first of two dimensions, posterior variance 4: the variance is 100 / 4 = 25, times 4 = 100.
    annealing = Annealing.of(pairs(torch.tensor([[10.0, 0.0], [-10.0, 0.0]]), math.log(4.0)), 100, 2)
    assert annealing.first_temperature == pytest.approx(100)
    assert [annealing.temperature(step) for step in (0, 50, 100)] == pytest.approx([100, 10, 1])
    assert annealing.unit.tolist() == pytest.approx([2.0, 2.0])


def test_targets_closer_than_a_posterior_need_no_heat():
    assert Annealing.of(pairs(torch.tensor([[0.1], [-0.1]])), 10, 2).first_temperature == 4.0


def test_the_annealed_loss_by_hand():
    # Means 0 and 2, target 0.5, temperature 1, unit 1: distances 0.25 and 2.25, shares 1 : e^-1 = 0.731059 : 0.268941.
    # log N(0.5; 0, 1) = -1.043939, log N(0.5; 2, 1) = -2.043939, log weights -log 2 = -0.693147.
    mixture = GaussianMixture(torch.full((1, 2), 0.5).log(), torch.tensor([[[0.0], [2.0]]]), torch.zeros(1, 2, 1))
    annealing = Annealing(steps=1, unit=torch.ones(1), first_temperature=5.0, nudge=torch.zeros(2, 1))
    loss = float(annealing.loss(mixture, pairs(torch.tensor([[0.5]])), 1))
    assert loss == pytest.approx(0.731059 * (1.043939 + 0.693147) + 0.268941 * (2.043939 + 0.693147), abs=1e-5)


def test_equal_components_are_nudged_apart():
    # Both means at one place: without the nudge their shares, and so their gradients, would be equal for ever.
    means = torch.zeros(1, 2, 3, requires_grad=True)
    mixture = GaussianMixture(torch.full((1, 2), 0.5).log(), means, torch.zeros(1, 2, 3))
    targets = torch.tensor([[3.0, 0.0, 0.0], [-3.0, 0.0, 0.0]])
    annealing = Annealing.of(pairs(targets), 10, 2)
    torch.testing.assert_close(annealing.nudge.norm(dim=1), torch.tensor([0.2, 0.2]))
    torch.testing.assert_close(annealing.nudge.sum(dim=0), torch.zeros(3))
    annealing.loss(mixture, pairs(targets[:1]), 0).backward()
    assert (means.grad[0, 0] - means.grad[0, 1]).abs().max() > 0.01


def test_narrow_and_heavy_components_do_not_claim_more_targets():
    # The share depends on distance alone: equal distances give equal gradients on both weights' logits.
    logits = torch.tensor([[math.log(0.99), math.log(0.01)]], requires_grad=True)
    sigmas = torch.tensor([[[2.0], [-2.0]]])
    mixture = GaussianMixture(torch.log_softmax(logits, dim=1), torch.tensor([[[-1.0], [1.0]]]), sigmas)
    annealing = Annealing(steps=10, unit=torch.ones(1), first_temperature=3.0, nudge=torch.zeros(2, 1))
    annealing.loss(mixture, pairs(torch.tensor([[0.0]])), 5).backward()
    # Cross-entropy with shares 1/2: gradient = weight - share.
    torch.testing.assert_close(logits.grad, torch.tensor([[0.49, -0.49]]))


# --- health ---


class Fixed(MDN):
    """Always the same mixture."""

    def __init__(self, mixture: GaussianMixture):
        super().__init__(1, 2, 4)
        self.mixture = mixture

    def forward(self, mean, logvar):
        expand = [part.expand(len(mean), *part.shape[1:]) for part in vars(self.mixture).values()]
        return GaussianMixture(*expand)


def health_of(weights: list[float], means: list[float], sigma: float) -> MixtureHealth:
    log_sigmas = torch.full((1, len(means), 1), math.log(sigma))
    mixture = GaussianMixture(torch.tensor([weights]).log(), torch.tensor([means])[:, :, None], log_sigmas)
    return mixture_health(Fixed(mixture), one_step((-3.0, 3.0), 0))


def test_n76_health_of_two_modes(numeric_row):
    health = health_of([0.5, 0.5], [-3.0, 3.0], 1.0)
    assert (health.effective_components, health.used_components) == pytest.approx((2.0, 2.0))
    numeric_row("N76", "two modes: components in use, from 2", abs(health.used_components - 2), 1e-5)
    assert health.largest_weight == 0.5 and health.several_modes == 1.0
    # The true law: about log 2 + 1.4189 nats. One Gaussian of variance 10: 0.5 log(20 pi) + 0.5 = 2.5702 nats.
    assert health.nll == pytest.approx(math.log(2) + 1.4189, abs=0.2)
    assert health.single_nll == pytest.approx(2.5702, abs=0.2)


def test_n76_health_of_a_collapsed_mixture(numeric_row):
    # Entropy of (0.96, 0.04): exp(0.96 * 0.040822 + 0.04 * 3.218876) = exp(0.167944) = 1.18287.
    health = health_of([0.96, 0.04], [0.0, 0.1], 3.0)
    worst = abs(health.effective_components - 1.18287)
    numeric_row("N76", "weights 0.96 and 0.04: components in use, from 1.18287", worst, 1e-4)
    numeric_row("N76", "two components at one place: share of sources said to have two modes", health.several_modes)
    assert health.largest_weight == pytest.approx(0.96) and health.several_modes == 0.0
    assert health.single_nll == pytest.approx(health.nll, abs=1e-3)


def test_health_of_equal_components_and_of_one():
    assert health_of([0.5, 0.5], [1.0, 1.0], 1.0).several_modes == 0.0
    single = health_of([1.0], [0.0], 1.0)
    assert (single.effective_components, single.several_modes) == (1.0, 0.0)
    assert single.nll == pytest.approx(single.single_nll)


# --- errors ---


@pytest.mark.parametrize(
    "change",
    [{"components": 0}, {"steps": 0}, {"lr": 0.0}, {"final_lr": 1.0}, {"split_share": 1.0}, {"gradient_limit": 0.0}],
)
def test_impossible_settings_are_refused_by_name(change):
    with pytest.raises(UserError, match=rf"mdn\.{next(iter(change))}"):
        MdnConfig(**change)
