"""What lower precision costs a mixture, and that a second component is used only where there is something to choose."""

import math
from pathlib import Path

import torch

from carff.mdn import MDN
from carff.mdn_training import MdnConfig, MixtureHealth, build_mdn, mixture_health, train_mdn
from carff.mixtures import mixture_from_raw, negative_log_likelihood
from carff.transitions import TransitionConfig, TransitionSampler, ViewBeliefs
from tests.hashnerf.numerics import LADDER, change_under_autocast, ladder_errors


def test_t01_likelihood_of_a_mixture(numeric_row):
    generator = torch.Generator().manual_seed(0)
    raw = [torch.randn(shape, generator=generator) for shape in ((16, 3), (16, 3, 8), (16, 3, 8), (16, 5, 8))]

    def nll(logits, means, log_sigmas, values):
        return negative_log_likelihood(mixture_from_raw(logits, means, log_sigmas), values)

    for dtype, error, accepted in zip(LADDER, ladder_errors(nll, *raw), (1e-6, 1e-3, 8e-3)):
        numeric_row("T01", f"mixture's likelihood, inputs in {dtype}: relative error", error, accepted)
    numeric_row("T01", "mixture's likelihood: change under autocast", change_under_autocast(nll, *raw))


def test_t01_whole_mixture_network(numeric_row):
    generator = torch.Generator().manual_seed(0)
    mdn = MDN(8, 2, width=64).eval()
    mean, logvar = torch.randn(2, 32, 8, generator=generator)
    with torch.no_grad(), torch.autocast("cpu", enabled=False):
        found = []
        for dtype in LADDER:
            with torch.autocast("cpu", dtype=dtype, enabled=dtype != torch.float32, cache_enabled=False):
                found.append(mdn(mean, logvar))
        exact = mdn.double()(mean.double(), logvar.double())
    errors = [float((one.means.double() - exact.means).abs().max() / exact.means.abs().max()) for one in found]
    for dtype, error, accepted in zip(LADDER, errors, (1e-5, 5e-3, 4e-2)):
        numeric_row("T01", f"mixture's network, products in {dtype}: relative error of the means", error, accepted)
    assert errors == sorted(errors)
    assert all(one.log_weights.dtype == torch.float32 for one in found), "the mixture itself is float32"


def circle(cameras: int) -> torch.Tensor:
    angle = torch.arange(cameras) * 2 * math.pi / cameras
    poses = torch.eye(4).repeat(cameras, 1, 1)
    poses[:, 0, 3], poses[:, 1, 3] = 10 * angle.cos(), 10 * angle.sin()
    return poses


def sampler_of(means: list[float], logvar: float) -> TransitionSampler:
    """Branches of two steps in one dimension; consecutive pairs of means are one branch now and next."""
    count = len(means)
    views = ViewBeliefs(
        torch.tensor(means)[:, None, None].expand(count, 3, 1),
        torch.full((count, 3, 1), logvar),
        torch.ones(count, 3, dtype=torch.bool),
    )
    successor = torch.tensor([number + 1 if number % 2 == 0 else -1 for number in range(count)])
    return TransitionSampler(views, successor, circle(3), TransitionConfig(), 0)


def trained(sampler: TransitionSampler, folder: Path, components: int, steps: int = 150) -> tuple[MDN, MixtureHealth]:
    torch.manual_seed(0)
    config = MdnConfig(width=32, steps=steps, batch_size=64, save_every=1000, components=components)
    mdn = build_mdn(config, 1)
    train_mdn(config, mdn, sampler, folder, {})
    return mdn.eval(), mixture_health(mdn.eval(), sampler)


def test_t06_one_mode_needs_one_component(tmp_path, numeric_row):
    sampler = sampler_of([0.0, 0.0, 0.0, 0.0], 0.0)
    values = torch.randn(1, 20_000, 1, generator=torch.Generator().manual_seed(0))
    nats, health = {}, {}
    for components in (1, 2):
        mdn, health[components] = trained(sampler, tmp_path / str(components), components)
        with torch.no_grad():
            nats[components] = float(negative_log_likelihood(mdn(torch.zeros(1, 1), torch.zeros(1, 1)), values))
    of_two = health[2]
    about = f"one mode: {of_two.effective_components:.2f} effective components of 2"
    numeric_row("T06", f"{about}: nats that one component loses", max(nats[1] - nats[2], 0.0), 0.05)
    numeric_row("T06", "one mode: share of sources said to have several", of_two.several_modes)
    # the single Gaussian of the report says the same without a second training
    lost = of_two.single_nll - of_two.nll
    numeric_row("T06", "one mode: nats that the mixture's own single Gaussian loses", lost, 0.05)
    assert health[1].effective_components == 1.0


def test_t06_what_is_fully_seen_is_forecast_with_the_targets_own_spread(tmp_path, numeric_row):
    # six views, each with a mean of its own, so that nothing is left to guess but the target's posterior itself
    logvar = -6.0
    mdn, health = trained(sampler_of([-2.0, -1.0, 0.0, 0.5, 2.0, 1.5], logvar), tmp_path / "run", 2, steps=600)
    with torch.no_grad():
        sources = torch.tensor([[-2.0], [0.0], [2.0]])
        variance = mdn(sources, torch.full_like(sources, logvar)).variance()
    worst = float((0.5 * (variance.log() - logvar)).exp().max())
    numeric_row("T06", "all is seen: greatest standard deviation beside the posterior's own", worst, 1.6)
    numeric_row("T06", "all is seen: share of sources said to have several modes", health.several_modes)
