import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from carff.beliefs import (
    Belief,
    active_units,
    bhattacharyya_coefficient,
    bound_logvar,
    indistinguishable_states,
    kl_per_dimension,
    kl_to_standard_normal,
    reparameterise,
    require_latents,
    sample_beliefs,
    soft_bound,
    view_distinctness,
)
from tests.hashnerf.refusals import refuses

RAW = [
    -math.inf,
    -300,
    -100,
    -50,
    -30,
    -1,
    -1e-2,
    -1e-3,
    -1e-4,
    0,
    1e-4,
    1e-3,
    1e-2,
    1,
    10,
    11.1,
    20,
    50,
    88.8,
    100,
    300,
]


def one(mean: float, logvar: float, dtype=torch.float32) -> Belief:
    return Belief(torch.tensor([[mean]], dtype=dtype), torch.tensor([[logvar]], dtype=dtype))


# --- bounds ---


def test_bound_is_the_identity_inside_and_stays_between_the_bounds():
    inside = torch.linspace(-11, 7, 100)
    assert torch.equal(bound_logvar(inside), inside)
    # One unit beyond the bend: 7 + (1 - 1 / (1 + 1)) = 7.5; three units below the lower one: -11 - (1 - 1/4) = -11.75.
    assert bound_logvar(torch.tensor([8.0, -14.0])).tolist() == pytest.approx([7.5, -11.75])
    everything = bound_logvar(torch.tensor(RAW))
    assert (everything >= -12).all() and (everything <= 8).all()


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_bound_is_monotone(first, second):
    low, high = sorted((first, second))
    assert bound_logvar(torch.tensor(low)) <= bound_logvar(torch.tensor(high))


def test_bound_passes_gradcheck_on_both_sides_of_the_bends():
    raw = torch.tensor([-300.0, -20, -11.5, -3, 0, 6, 7.5, 9, 400], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda values: soft_bound(values, -12.0, 8.0), raw)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_is_bounded_as_float32(dtype):
    raw = torch.tensor([-50.0, 0.3, 20.0], dtype=dtype)
    assert torch.equal(bound_logvar(raw), bound_logvar(raw.float()))


# --- KL ---


@pytest.mark.parametrize(
    ("logvar", "expected", "relative"),
    [
        (1e-4, 2.5e-9, 1e-3),
        (-1e-4, 2.5e-9, 1e-3),
        (1e-2, 2.508354208e-5, 2e-5),
        (10.0, 11007.7329, 2e-5),
        (-50.0, 24.5, 2e-5),
        (20.0, 242582587.2, 2e-5),
    ],
)
def test_n61_kl_of_a_centred_gaussian(logvar, expected, relative, numeric_row):
    worst = abs(float(kl_to_standard_normal(one(0.0, logvar))) / expected - 1)
    numeric_row("N61", f"float32, log-variance {logvar}, by hand: relative error", worst, relative)


def test_kl_by_hand():
    # mean 2, variance 1: 0.5 * (4 + 1 - 0 - 1) = 2; mean 0, variance e: 0.5 * (e - 1 - 1) = 0.359141.
    belief = Belief(torch.tensor([[2.0, 0.0]]), torch.tensor([[0.0, 1.0]]))
    assert kl_per_dimension(belief)[0].tolist() == pytest.approx([2.0, 0.5 * (math.e - 2)])
    assert float(kl_to_standard_normal(belief)) == pytest.approx(2.359141, rel=1e-6)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16, torch.float16])
def test_n60_kl_of_bounded_log_variances_is_finite_and_leads_back(dtype, numeric_row):
    largest = torch.finfo(dtype).max
    pairs = torch.cartesian_prod(torch.tensor(RAW), torch.tensor([0.0, 1.0, 1e4, 1e6]).clamp(max=largest)).to(dtype)
    raw, means = pairs[:, 0].clone().requires_grad_(), pairs[:, 1:].clone().requires_grad_()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        kl = kl_to_standard_normal(Belief(means, bound_logvar(raw)[:, None]))
    kl.sum().backward()
    about = f"{dtype} and autocast, means 0 to 1e6, raw log-variances from -inf to 300"
    broken = (~kl.isfinite()).sum() + (~raw.grad.isfinite()).sum() + (~means.grad.isfinite()).sum() + (kl < 0).sum()
    numeric_row("N60", f"{about}: not finite, or KL below 0", broken)
    too_wide, too_narrow = raw.detach() > 8, (raw.detach() < -12) & torch.isfinite(raw.detach())
    stuck = (raw.grad[too_wide] <= 0).sum() + (raw.grad[too_narrow] >= 0).sum()
    numeric_row("N60", f"{about}: beyond the bounds without a way back", stuck)
    numeric_row("N60", f"{about}: largest gradient", raw.grad.abs().max(), 0.5 * math.exp(8))


@given(st.floats(-12, 8))
def test_kl_is_never_negative_and_matches_float64(logvar):
    value = kl_to_standard_normal(one(0.0, logvar)).item()
    rounded = torch.tensor(logvar).double()
    exact = 0.5 * float(torch.expm1(rounded) - rounded)
    assert value >= 0
    if abs(logvar) >= 1e-2:
        assert value == pytest.approx(exact, rel=2e-5)


def test_n61_kl_near_zero_keeps_all_digits_of_value_and_gradient(numeric_row):
    # expm1(l) - l loses three digits at l = 1e-4 in float32; (expm1(l) + 1) - 1 in its gradient loses four.
    size = torch.logspace(-6, -1, 60)
    logvar = torch.cat([size, -size])[:, None].requires_grad_()
    kl = kl_to_standard_normal(Belief(torch.zeros_like(logvar), logvar))
    kl.sum().backward()
    exact = logvar.detach().double()[:, 0]
    series = exact**2 / 4 * (1 + exact / 3 + exact**2 / 12 + exact**3 / 60 + exact**4 / 360)
    slope = 0.5 * torch.expm1(exact)
    about = "float32, log-variances +-1e-6 to +-0.1"
    numeric_row("N61", f"{about}: KL below 0", (kl < 0).sum())
    kl = kl.detach()
    numeric_row("N61", f"{about}: relative error", ((kl.double() - series).abs() / series).max(), 2e-5)
    worst = ((logvar.grad[:, 0].double() - slope).abs() / slope.abs()).max()
    numeric_row("N61", f"{about}: relative error of the gradient", worst, 2e-5)


def test_n61_kl_of_wide_and_narrow_gaussians(numeric_row):
    logvar = torch.cat([-torch.logspace(-2, math.log10(50), 200), torch.logspace(-2, math.log10(20), 200)])
    kl = kl_to_standard_normal(Belief(torch.zeros(400, 1), logvar[:, None]))
    truth = 0.5 * (torch.expm1(logvar.double()) - logvar.double())
    worst = ((kl.double() - truth).abs() / truth).max()
    numeric_row("N61", "float32, log-variances -50 to 20, 0.01 or more from 0: relative error", worst, 2e-5)


def test_kl_gradient_near_zero_and_gradcheck():
    logvar = torch.tensor([[-1e-3, 1e-3, 9.9e-3, 1.01e-2, -4.0, 5.0]], dtype=torch.float64, requires_grad=True)
    mean = torch.randn(1, 6, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda m, v: kl_to_standard_normal(Belief(m, v)), (mean, logvar))
    small = torch.tensor([[1e-4]], requires_grad=True)
    kl_to_standard_normal(Belief(torch.zeros(1, 1), small)).backward()
    assert float(small.grad) == pytest.approx(0.5 * math.expm1(1e-4), rel=1e-3)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_n61_kl_is_the_same_under_autocast_and_from_half_precision(dtype, numeric_row):
    logvar = torch.randn(5, 8) * torch.logspace(-3, 0, 8)
    belief = Belief(torch.zeros(5, 8), logvar)
    half = Belief(belief.mean.to(dtype), logvar.to(dtype))
    outside = kl_to_standard_normal(belief)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        worst = ((kl_to_standard_normal(belief) - outside).abs() / outside).max()
        numeric_row("N61", "relative change under autocast", worst, 1e-6)
        upcast = kl_per_dimension(Belief(half.mean.float(), half.logvar.float()))
        assert kl_per_dimension(half).dtype == torch.float32
        worst = ((kl_per_dimension(half) - upcast).abs() / upcast).max()
        numeric_row("N61", f"{dtype}: relative change beside float32", worst, torch.finfo(dtype).eps)
        numeric_row("N61", f"{dtype}: KL below 0", (kl_per_dimension(half) < 0).sum())


def test_kl_matches_a_monte_carlo_estimate():
    belief = one(0.7, -0.8, torch.float64)
    draws = sample_beliefs(belief, 200_000, torch.Generator().manual_seed(0))[0, :, 0]
    q = torch.distributions.Normal(0.7, math.exp(-0.4)).log_prob(draws)
    p = torch.distributions.Normal(0.0, 1.0).log_prob(draws)
    error = float((q - p).std()) / math.sqrt(len(draws))
    assert abs(float((q - p).mean()) - float(kl_to_standard_normal(belief))) < 4 * error


# --- sampling ---


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16, torch.float16])
def test_n62_samples_of_bounded_beliefs_are_finite_and_have_the_slope_of_their_noise(dtype, monkeypatch, numeric_row):
    raws, noises = [-100.0, -50.0, 0.0, 50.0, 100.0, 200.0], torch.tensor([0.0, 6.0, -6.0])
    monkeypatch.setattr("carff.beliefs.torch.randn", lambda *shape, **_: noises.repeat(len(raws))[None, None])
    raw = torch.tensor(raws).repeat_interleave(3)[None].to(dtype)
    logvar = bound_logvar(raw).to(dtype).detach().requires_grad_()
    mean = torch.ones(1, len(raws) * 3, dtype=dtype, requires_grad=True)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        sample = reparameterise(Belief(mean, logvar))
    sample.sum().backward()
    sample = sample.detach()
    sigma, noise = torch.exp(0.5 * logvar.detach().double()), noises.repeat(len(raws))[None].double()
    broken = (~sample.isfinite()).sum() + (~logvar.grad.isfinite()).sum() + (mean.grad != 1).sum()
    about = f"{dtype} and autocast, raw log-variances -100 to 200, noise 0 and +-6"
    numeric_row("N62", f"{about}: not finite", broken)
    worst = ((sample.double() - 1 - sigma * noise).abs() / (1 + (sigma * noise).abs())).max()
    numeric_row("N62", f"{about}: relative error of a sample", worst, 1e-6)
    slope = 0.5 * noise * sigma
    worst = ((logvar.grad.double() - slope).abs() / slope.abs().clamp(min=1e-12)).max()
    cast = 1e-5 if dtype == torch.float32 else torch.finfo(dtype).eps
    numeric_row("N62", f"{about}: relative error of the gradient", worst, cast)


def test_reparameterisation_gradient_is_half_the_noise():
    logvar = torch.linspace(-11, 7, 50)[None].requires_grad_()
    mean = torch.ones(1, 50, requires_grad=True)
    sample = reparameterise(Belief(mean, logvar), torch.Generator().manual_seed(1))
    sample.sum().backward()
    # z = mean + sigma * eps, so dz/dlogvar = sigma * eps / 2 = (z - mean) / 2 and dz/dmean = 1.
    torch.testing.assert_close(logvar.grad, 0.5 * (sample - mean).detach(), rtol=1e-5, atol=1e-6)
    assert torch.equal(mean.grad, torch.ones(1, 50))


def test_n62_a_belief_without_spread_gives_its_mean_and_a_finite_gradient(numeric_row):
    logvar = torch.full((1, 3), -math.inf, requires_grad=True)
    sample = reparameterise(Belief(torch.tensor([[1.0, 2.0, 3.0]]), logvar))
    sample.sum().backward()
    worst = (sample.detach() - torch.tensor([1.0, 2.0, 3.0])).abs().max()
    numeric_row("N62", "sigma 0: distance from the mean", worst)
    numeric_row("N62", "sigma 0: gradients that are not finite", (~logvar.grad.isfinite()).sum())


def test_samples_have_the_belief_moments_and_repeat_with_the_seed():
    belief = Belief(torch.tensor([[1.0, -2.0]]), torch.tensor([[0.0, math.log(4.0)]]))
    draws = sample_beliefs(belief, 100_000, torch.Generator().manual_seed(3))[0]
    assert draws.mean(dim=0).tolist() == pytest.approx([1, -2], abs=4 * 2 / math.sqrt(1e5))
    assert draws.std(dim=0).tolist() == pytest.approx([1, 2], rel=0.02)
    assert torch.equal(draws, sample_beliefs(belief, 100_000, torch.Generator().manual_seed(3))[0])


# --- overlap ---


def test_overlap_by_hand():
    # Equal variances v: exp(-d^2 / (8 v)); d = 2, v = 1: exp(-0.5) = 0.606531.
    # Equal means, deviations s and t: sqrt(2 s t / (s^2 + t^2)); s = 1, t = 3: sqrt(6 / 10) = 0.774597.
    shifted = bhattacharyya_coefficient(one(0.0, 0.0), one(2.0, 0.0))
    widened = bhattacharyya_coefficient(one(0.0, 0.0), one(0.0, math.log(9.0)))
    assert float(shifted) == pytest.approx(0.606531, rel=1e-6)
    assert float(widened) == pytest.approx(0.774597, rel=1e-6)


def test_overlap_matches_numerical_integration():
    x = torch.linspace(-40, 40, 200_001, dtype=torch.float64)
    p = torch.exp(-0.5 * ((x - 0.3) / 1.7) ** 2) / (1.7 * math.sqrt(2 * math.pi))
    q = torch.exp(-0.5 * ((x + 1.1) / 0.4) ** 2) / (0.4 * math.sqrt(2 * math.pi))
    integral = float(torch.trapezoid((p * q).sqrt(), x))
    a, b = one(0.3, 2 * math.log(1.7), torch.float64), one(-1.1, 2 * math.log(0.4), torch.float64)
    assert float(bhattacharyya_coefficient(a, b)) == pytest.approx(integral, rel=1e-8)


@settings(max_examples=50)
@given(st.lists(st.tuples(*[st.floats(-1e6, 1e6)] * 2, *[st.floats(-12, 8)] * 2), min_size=1, max_size=8))
def test_overlap_is_a_symmetric_number_between_zero_and_one(rows):
    values = torch.tensor(rows)
    a, b = Belief(values[:, :1], values[:, 2:3]), Belief(values[:, 1:2], values[:, 3:])
    overlap = bhattacharyya_coefficient(a, b)
    assert ((overlap >= 0) & (overlap <= 1)).all()
    torch.testing.assert_close(overlap, bhattacharyya_coefficient(b, a), rtol=1e-5, atol=1e-12)
    assert torch.equal(bhattacharyya_coefficient(a, a), torch.ones(len(rows)))


# --- distinctness of views ---


def test_distinctness_by_hand():
    # Camera 0 sees means 0, 0, 2 (variance 1): states 0 and 1 look alike, state 2 overlaps exp(-0.5) with each.
    # Camera 1 sees 0, 4, 8: neighbours overlap exp(-16 / 8) = 0.135335. State 2 has no view there.
    means = torch.tensor([[0.0, 0.0], [0.0, 4.0], [2.0, 8.0]])[:, :, None]
    valid = torch.tensor([[True, True], [True, True], [True, False]])
    distinct = view_distinctness(means, torch.zeros_like(means), valid)
    expected = [[0, 1 - math.exp(-2)], [0, 1 - math.exp(-2)], [1 - math.exp(-0.5), 0]]
    torch.testing.assert_close(distinct, torch.tensor(expected))


def test_states_that_no_camera_tells_apart_do_not_silence_the_cameras():
    # States 0 and 1 have equal beliefs everywhere (a first state that two branches share); state 2 is far away.
    means = torch.tensor([[1.0, 2.0], [1.0, 2.0], [60.0, 60.0]])[:, :, None]
    valid = torch.ones(3, 2, dtype=torch.bool)
    assert indistinguishable_states(means, torch.zeros_like(means), valid).tolist() == [0, 0, 2]
    assert view_distinctness(means, torch.zeros_like(means), valid).tolist() == [[1.0, 1.0]] * 3


def test_states_without_a_common_camera_are_not_grouped():
    means = torch.zeros(2, 2, 1)
    valid = torch.tensor([[True, False], [False, True]])
    assert indistinguishable_states(means, means, valid).tolist() == [0, 1]
    assert view_distinctness(means, means, valid).tolist() == [[1.0, 0.0], [0.0, 1.0]]


def test_distinctness_knows_no_labels():
    means, logvars = torch.randn(5, 4, 3), torch.randn(5, 4, 3)
    valid = torch.rand(5, 4) > 0.2
    order = torch.randperm(5)
    shuffled = view_distinctness(means[order], logvars[order], valid[order])
    torch.testing.assert_close(shuffled, view_distinctness(means, logvars, valid)[order])


# --- health ---


def test_n64_active_units_of_working_and_collapsed_encoders(caplog, numeric_row):
    means = torch.stack([torch.linspace(-1, 1, 50), torch.linspace(-0.01, 0.01, 50)], dim=1)
    assert active_units(means).tolist() == [True, False]
    assert not caplog.records
    assert active_units(torch.zeros(50, 8)).sum() == 0
    numeric_row("N64", "means that are all 0: no warning", float("collapsed" not in caplog.text))


def test_n64_a_decoder_that_ignores_the_latent_leaves_no_unit_active(caplog, numeric_row):
    # its error has no gradient: the KL term alone teaches the encoder
    means, raw = torch.randn(50, 8).requires_grad_(), torch.randn(50, 8).requires_grad_()
    optimizer = torch.optim.Adam([means, raw], lr=0.1)
    for _ in range(150):
        optimizer.zero_grad()
        kl_to_standard_normal(Belief(means, bound_logvar(raw))).mean().backward()
        optimizer.step()
    per_dimension = kl_per_dimension(Belief(means, bound_logvar(raw))).mean(dim=0).detach()
    numeric_row("N64", "a constant decoder: active units", active_units(means.detach()).sum())
    numeric_row("N64", "a constant decoder: mean KL of a dimension, nats", per_dimension.max(), 1e-3)
    numeric_row("N64", "a constant decoder: no warning", float("collapsed" not in caplog.text))


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e20, -2e6])
def test_n60_n71_latents_that_would_overflow_are_rejected_by_row(bad, numeric_row):
    values = torch.zeros(5, 3)
    require_latents(values, "means")
    values[3, 1] = bad
    accepted = not refuses("means: row 3 of 5", require_latents, values, "means")
    numeric_row("N60", f"a mean of {bad}: accepted", accepted)
    numeric_row("N71", f"a latent of {bad}: accepted, or its row not named", accepted)


def test_wrong_shapes_raise():
    with pytest.raises(Exception, match="Belief"):
        Belief(torch.zeros(3, 2), torch.zeros(3, 4))
