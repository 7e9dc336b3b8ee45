import itertools
import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from carff.mixtures import (
    GaussianMixture,
    choose_component,
    mixture_from_raw,
    negative_log_likelihood,
    spread_components,
)


def mixture(weights: list[float], means: list[list[float]], sigmas: list[list[float]], dtype=torch.float64):
    return GaussianMixture(
        torch.tensor([weights], dtype=dtype).log(),
        torch.tensor([means], dtype=dtype),
        torch.tensor([sigmas], dtype=dtype).log(),
    )


# --- density ---


def test_n73_density_goldens(numeric_row):
    # K=2, D=8, means 0 and 1, sigma 1, y = 0: -log(0.5 (2 pi)^-4 (1 + e^-4)) = 4 log(2 pi) + log 2 - log(1 + e^-4).
    two = mixture([0.5, 0.5], [[0.0] * 8, [1.0] * 8], [[1.0] * 8] * 2)
    value = float(negative_log_likelihood(two, torch.zeros(1, 1, 8, dtype=torch.float64)))
    numeric_row("N73", "two components, 8 dimensions, by hand: nats", abs(value - 8.02650551828), 1e-10)
    # K=1, D=8, y = 0.5 everywhere: 4 log(2 pi) + 8 * 0.5 * 0.25 = 7.35150826564 + 1.
    one = mixture([1.0], [[0.0] * 8], [[1.0] * 8])
    value = float(negative_log_likelihood(one, torch.full((1, 1, 8), 0.5, dtype=torch.float64)))
    numeric_row("N73", "one component, 8 dimensions, by hand: nats", abs(value - 8.35150826564), 1e-10)


def slow_log_prob(mix: GaussianMixture, values: torch.Tensor) -> torch.Tensor:
    rows = []
    for b, s in itertools.product(range(values.shape[0]), range(values.shape[1])):
        terms = []
        for k in range(mix.means.shape[1]):
            log = float(mix.log_weights[b, k])
            for d in range(mix.means.shape[2]):
                sigma = math.exp(float(mix.log_sigmas[b, k, d]))
                z = (float(values[b, s, d]) - float(mix.means[b, k, d])) / sigma
                log += -0.5 * z * z - math.log(sigma) - 0.5 * math.log(2 * math.pi)
            terms.append(log)
        top = max(terms)
        rows.append(top + math.log(sum(math.exp(term - top) for term in terms)))
    return torch.tensor(rows, dtype=torch.float64).view(values.shape[:2])


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 3), st.integers(1, 4), st.integers(1, 5), st.integers(0, 10**6))
def test_density_matches_the_definition(b, k, d, seed):
    generator = torch.Generator().manual_seed(seed)
    draw = [torch.randn(shape, generator=generator, dtype=torch.float64) for shape in [(b, k), (b, k, d), (b, k, d)]]
    mix = mixture_from_raw(*draw)
    values = 3 * torch.randn(b, 4, d, generator=generator, dtype=torch.float64)
    torch.testing.assert_close(mix.log_prob(values), slow_log_prob(mix, values), rtol=1e-10, atol=1e-10)


def test_density_integrates_to_one():
    mix = mixture([0.2, 0.8], [[-3.0], [1.0]], [[0.3], [2.0]])
    x = torch.linspace(-40, 40, 100_001, dtype=torch.float64)
    assert float(torch.trapezoid(mix.log_prob(x[None, :, None])[0].exp(), x)) == pytest.approx(1, abs=1e-9)


def test_gradcheck():
    generator = torch.Generator().manual_seed(0)
    shapes = [(2, 3), (2, 3, 4), (2, 3, 4), (2, 5, 4)]
    inputs = [torch.randn(s, generator=generator, dtype=torch.float64).requires_grad_() for s in shapes]
    assert torch.autograd.gradcheck(lambda w, m, s, y: mixture_from_raw(w, m, s).log_prob(y), inputs)


@pytest.mark.parametrize("dimensions", [1, 8, 64, 256])
def test_n73_float32_values_and_gradients_follow_float64(dimensions, numeric_row):
    generator = torch.Generator().manual_seed(dimensions)
    errors, slopes = [], []
    for components, batch, target, raw, spread in itertools.product(
        [1, 2, 5, 64], [1, 16], [0.0, 1.0, 1e2, 1e4], [0.1, 1.0, 10.0, 1e3], [1.0, 1e4]
    ):
        shapes = [(batch, components), (batch, components, dimensions), (batch, components, dimensions)]
        scales = [spread, 1.0, raw]
        inputs = [scale * torch.randn(s, generator=generator) for s, scale in zip(shapes, scales)]
        results = []
        for dtype in (torch.float32, torch.float64):
            leaves = [values.detach().to(dtype).requires_grad_() for values in inputs]
            values = torch.full((batch, 1, dimensions), target, dtype=dtype)
            loss = negative_log_likelihood(mixture_from_raw(*leaves), values)
            loss.backward()
            results.append((loss.detach().double(), [leaf.grad.double() for leaf in leaves]))
        (value, gradients), (exact, exact_gradients) = results
        errors.append((value - exact).abs() / (1 + exact.abs()))
        for gradient, exact_gradient in zip(gradients, exact_gradients):
            excess = (gradient - exact_gradient).abs().max() - 1e-2
            slopes.append(excess / exact_gradient.abs().max().clamp(min=1e-12))
    about = f"{dimensions} dimensions, 1 to 64 components, targets to 1e4, raw log-sigmas to 1e3, logits to 1e4"
    numeric_row("N73", f"{about}: error, relative to 1 nat and itself", torch.stack(errors).max(), 1e-5)
    worst = torch.stack(slopes).max().clamp(min=0)
    numeric_row("N73", f"{about}: error of a gradient above 0.01, relative to the largest", worst, 2e-2)


# --- extremes ---


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.bfloat16])
def test_n70_n71_any_raw_sigma_and_distance_has_a_finite_value_and_gradient(dtype, numeric_row):
    broken, broken_far = 0, 0
    for raw, offset, lone in itertools.product(
        [-1e3, -110.0, -50.0, 0.0, 50.0, 1e3], [0.0, 1e-12, 1.0, 1e2, 1e4, 1e6], [False, True]
    ):
        logits = torch.zeros(1, 2, dtype=dtype).requires_grad_()
        means = torch.zeros(1, 2, 8, dtype=dtype).requires_grad_()
        other = raw if lone else 0.5  # both components out of bounds, or one beside a good one
        sigmas = torch.tensor([[[raw] * 8, [other] * 8]], dtype=dtype, requires_grad=True)
        values = torch.full((1, 3, 8), offset).clamp(max=torch.finfo(dtype).max).to(dtype).requires_grad_()
        with torch.autocast("cpu", dtype=torch.bfloat16):
            loss = negative_log_likelihood(mixture_from_raw(logits, means, sigmas), values)
        assert loss.dtype == torch.float32
        # a slope of e^14 has no number in float16
        leaves = (logits,) if dtype == torch.float16 else (logits, means, sigmas, values)
        loss.backward()
        bad = (~loss.isfinite()) + sum((~leaf.grad.isfinite()).sum() for leaf in leaves)
        broken, broken_far = broken + bad * (offset <= 1), broken_far + bad * (offset > 1)
    about = f"{dtype} and autocast, raw log-sigmas -1e3 to 1e3"
    numeric_row("N70", f"{about}, targets 0 to 1 off the mean: values or gradients that are not finite", broken)
    numeric_row("N71", f"{about}, targets 100 to 1e6 off the mean: values or gradients that are not finite", broken_far)


def test_n70_a_sigma_beyond_its_bound_is_still_pulled_back(numeric_row):
    # One component, targets at distance 1: sigma e^7 is too wide, sigma e^-7 too narrow, however far beyond the bound.
    stuck = 0
    for raw, sign in ((1e3, 1), (80.0, 1), (-80.0, -1), (-1e3, -1)):
        sigmas = torch.full((1, 1, 1), raw, requires_grad=True)
        negative_log_likelihood(
            mixture_from_raw(torch.zeros(1, 1), torch.zeros(1, 1, 1), sigmas), torch.ones(1, 1, 1)
        ).backward()
        stuck += not float(sigmas.grad) * sign > 1e-12
    numeric_row("N70", "raw log-sigmas of +-80 and +-1e3: without a way back", stuck)


@pytest.mark.parametrize("logits", [[0.0, -1e4], [0.0, -math.inf], [1e4, 0.0], [3.0, 3.0], [-1e4, -1e4]])
def test_n72_dead_and_equal_weights_are_finite(logits, numeric_row):
    leaf = torch.tensor([logits], requires_grad=True)
    means = torch.zeros(1, 2, 3, requires_grad=True)
    mix = mixture_from_raw(leaf, means, torch.zeros(1, 2, 3))
    loss = negative_log_likelihood(mix, torch.ones(1, 4, 3))
    loss.backward()
    broken = (~loss.isfinite()) + (~leaf.grad.isfinite()).sum() + (~means.grad.isfinite()).sum()
    numeric_row("N72", f"logits {logits}: not finite", broken)
    if logits[1] <= logits[0] - 1e4:
        numeric_row("N72", f"logits {logits}: gradient of the dead component", means.grad[0, 1].abs().max())
        assert means.grad[0, 0].abs().max() > 0


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_n70_n73_half_precision_inputs_are_computed_in_float32(dtype, numeric_row):
    raw = [torch.randn(2, 3, dtype=dtype), torch.randn(2, 3, 8, dtype=dtype), 30 * torch.randn(2, 3, 8, dtype=dtype)]
    values = 100 * torch.randn(2, 5, 8, dtype=dtype)
    upcast = mixture_from_raw(*(part.float() for part in raw)).log_prob(values.float())
    single = [part.float() for part in raw]
    with torch.autocast("cpu", dtype=torch.bfloat16):
        worst = (mixture_from_raw(*raw).log_prob(values) - upcast).abs().max()
        numeric_row("N70", f"{dtype} and autocast: change of the log-density beside float32", worst)
        worst = (mixture_from_raw(*single).log_prob(values.float()) - upcast).abs().max()
        numeric_row("N73", "float32 under autocast: change of the log-density", worst)


# --- sampling ---


@pytest.mark.parametrize("weights", [[0.9, 0.1], [0.999, 0.001], [1.0, 0.0], [0.0, 1.0]])
def test_n75_components_are_drawn_with_their_weights(weights, numeric_row):
    count = 1_000_000
    uniform = torch.rand(1, count, 2, generator=torch.Generator().manual_seed(0))
    chosen = choose_component(torch.tensor([weights]).log(), uniform)
    worst = abs(float((chosen == 1).double().mean()) - weights[1])
    accepted = 4 * math.sqrt(weights[1] * (1 - weights[1]) / count)
    numeric_row("N75", f"1e6 draws with weights {weights}: error of a share", worst, accepted)


def test_n74_a_search_that_would_run_off_the_end_finds_the_last_component(numeric_row):
    # these weights, cumulated in float32, end below the largest number that a uniform draw can be
    log_weights = torch.tensor([[0.25, 0.74999988]]).log()
    largest = 0.99999994
    assert log_weights.exp().cumsum(dim=1)[0, 1] < largest
    chosen = choose_component(log_weights, torch.full((1, 5, 2), largest))
    spread = spread_components(log_weights, torch.full((1, 1), largest), 5)
    numeric_row("N74", "uniform 0.99999994, each alone: not the last component", (chosen != 1).sum())
    wrong = (spread < 0).sum() + (spread > 1).sum() + (spread[0, -1] != 1)
    numeric_row("N74", "uniform 0.99999994, spread evenly: the last is not the last component", wrong)
    # in float64 the last of three places rounds to the very end
    alive = torch.tensor([[0.25, 0.75, 0.0]], dtype=torch.float64).log()
    spread = spread_components(alive, torch.full((1, 1), 1 - 2.0**-53, dtype=torch.float64), 3)
    numeric_row("N74", "uniform 1 - 2^-53, spread evenly: a dead component, or none", (spread > 1).sum())
    samples = GaussianMixture(log_weights, torch.tensor([[[-1.0], [1.0]]]), torch.full((1, 2, 1), -7.0)).sample(1000)
    numeric_row("N74", "samples that belong to no component", (samples.abs() - 1 > 0.1).sum())


def test_n74_extreme_uniform_numbers_choose_a_live_component(numeric_row):
    # Cumulated float32 weights (0.25, 0.99999988) end below a uniform 0.99999994: a search would run off the end.
    # The dead component comes first, where an argmax over nothing but -inf would find it.
    log_weights = torch.tensor([[0.0, 0.25, 0.74999988]]).log()
    extremes = [0.0, 2.0**-24, 0.5, 0.99999994]
    uniform = torch.tensor(list(itertools.product(extremes, repeat=3)))[None]
    chosen = choose_component(log_weights, uniform)
    numeric_row("N74", "uniform from 0 to 0.99999994: a dead component, or none", ((chosen < 1) | (chosen > 2)).sum())
    assert (chosen == 1).any() and (chosen == 2).any()


@pytest.mark.parametrize("count", [1, 2, 10, 35])
def test_systematic_draws_come_as_often_as_their_weight_says(count):
    weights = torch.tensor([[1 / 3, 2 / 3, 0.0], [0.0, 0.05, 0.95], [1.0, 0.0, 0.0]])
    uniform = torch.linspace(0, 0.99999994, 2001)
    rows = [spread_components(weights.log(), u.expand(3, 1), count) for u in uniform]
    counts = torch.stack([torch.nn.functional.one_hot(chosen, 3).sum(dim=1) for chosen in rows]).double()
    wanted = weights.double() * count
    assert (counts >= (wanted - 1e-5).floor()).all() and (counts <= (wanted + 1e-5).ceil()).all()
    torch.testing.assert_close(counts.mean(dim=0), wanted, rtol=0, atol=2e-3)


def test_systematic_samples_keep_the_moments():
    mix = mixture([0.3, 0.7], [[-1.0, 5.0], [2.0, 0.0]], [[0.5, 1.0], [1.0, 0.1]])
    draws = mix.sample(200_000, torch.Generator().manual_seed(1), systematic=True)[0]
    torch.testing.assert_close(draws.mean(dim=0), mix.mean()[0], rtol=0, atol=0.02)
    first = [mix.sample(2, torch.Generator().manual_seed(s), systematic=True)[0, 0, 1] > 2.5 for s in range(400)]
    assert sum(map(int, first)) / 400 == pytest.approx(0.3, abs=0.1), "also the first of two is a draw from the mixture"
    torch.testing.assert_close(draws.var(dim=0), mix.variance()[0], rtol=0.02, atol=0)


def test_n75_sample_moments_and_repetition(numeric_row):
    mix = mixture([0.3, 0.7], [[-1.0, 5.0], [2.0, 0.0]], [[0.5, 1.0], [1.0, 0.1]])
    draws = mix.sample(200_000, torch.Generator().manual_seed(1))
    again = mix.sample(200_000, torch.Generator().manual_seed(1))
    numeric_row("N75", "the same seed: other samples", (draws != again).sum())
    error = mix.variance()[0].sqrt() / math.sqrt(draws.shape[1])
    assert ((draws[0].mean(dim=0) - mix.mean()[0]).abs() < 4 * error).all()
    torch.testing.assert_close(draws[0].var(dim=0), mix.variance()[0], rtol=0.02, atol=0)


def test_rows_of_a_batch_are_sampled_from_their_own_mixture():
    means = torch.tensor([[[0.0], [10.0]], [[100.0], [110.0]]])
    mix = GaussianMixture(torch.full((2, 2), 0.5).log(), means, torch.full((2, 2, 1), -5.0))
    draws = mix.sample(50, torch.Generator().manual_seed(0)).round()[:, :, 0]
    assert set(draws[0].tolist()) == {0.0, 10.0} and set(draws[1].tolist()) == {100.0, 110.0}


# --- moments ---


def test_moments_by_hand():
    # Weights 1/4 and 3/4, means 0 and 4, sigmas 1 and 2: mean 3, variance (1/4 + 3/4 * 4) + (1/4 * 9 + 3/4 * 1) = 6.25.
    mix = mixture([0.25, 0.75], [[0.0], [4.0]], [[1.0], [2.0]])
    assert float(mix.mean()) == pytest.approx(3.0)
    assert float(mix.variance()) == pytest.approx(6.25)


def test_n77_variance_does_not_cancel_far_from_the_origin(numeric_row):
    # Means 1e4 -+ 1, sigma 1e-3, equal weights: 1 + 1e-6. E[x^2] - E[x]^2 loses it entirely in float32.
    mix = mixture([0.5, 0.5], [[9999.0], [10001.0]], [[1e-3], [1e-3]], torch.float32)
    numeric_row("N77", "means 1e4 +- 1, sigma 1e-3: relative error", abs(float(mix.variance()) / 1.000001 - 1), 1e-4)
    # weights that float32 does not sum to exactly 1
    mix = mixture([0.7, 0.2, 0.1], [[9999.0], [10001.0], [10000.0]], [[1e-3]] * 3, torch.float32)
    # mean 9999.5; 0.7 * 0.25 + 0.2 * 2.25 + 0.1 * 0.25 + 1e-6
    numeric_row("N77", "three of them, uneven: relative error", abs(float(mix.variance()) / 0.650001 - 1), 1e-4)
