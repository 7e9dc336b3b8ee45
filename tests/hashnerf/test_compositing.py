"""Volume rendering at the extremes, against closed forms and a slow float64 reference."""

import itertools
import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hashnerf.compositing import composite_colour, expected_depth, median_depth, sample_weights
from tests.hashnerf.numerics import LADDER, change_under_autocast, finite_gradients, ladder_errors

HALVES = [torch.float16, torch.bfloat16]


def slow_weights(density, dt):
    """Front to back, one sample at a time, in Python numbers."""
    rows = []
    for sigmas, lengths in zip(density.double().tolist(), dt.double().tolist()):
        thickness, row = 0.0, []
        for sigma, length in zip(sigmas, lengths):
            x = sigma * length
            row.append(math.exp(-thickness) * -math.expm1(-x))
            thickness += x
        rows.append(row)
    return torch.tensor(rows, dtype=torch.float64)


def exact_gradients(density, dt, colour):
    """Of the sum of weight times colour, by density and by length: own light minus what the sample hides behind it."""
    density, dt, colour = density.double(), dt.double(), colour.double()
    thickness = density * dt
    behind = torch.exp(-thickness.cumsum(dim=1))
    shown = all_weights(density, dt) * colour
    by_thickness = colour * behind - (shown.flip(1).cumsum(dim=1).flip(1) - shown)
    return dt * by_thickness, density * by_thickness


def all_weights(density, dt):
    """The same numbers as `slow_weights` without its loop, for thousands of samples."""
    thickness = density.double() * dt.double()
    before = torch.nn.functional.pad(thickness.cumsum(dim=1), (1, 0))[:, : thickness.shape[1]]
    return torch.exp(-before) * -torch.expm1(-thickness)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, *HALVES])
def test_n21_extremes_of_density_and_length(dtype, numeric_row):
    sigma = torch.tensor([0.0, 1e-12, 1.0, 1e6, 1e30, 1e38, math.inf], dtype=torch.float64)
    length = torch.tensor([0.0, 1e-10, 1e-4, 1.0, 1e10, math.inf], dtype=torch.float64)
    pairs = torch.cartesian_prod(sigma, length).to(dtype)
    density, dt = pairs[:, :1].repeat(1, 3), pairs[:, 1:].repeat(1, 3)
    weights, behind = sample_weights(density, dt)
    if dtype not in HALVES:  # a slope of 1e30 has no number in float16
        finite_gradients(lambda d, t: sample_weights(d, t)[0].sum(dim=1), density, dt)
    numeric_row("N21", f"{dtype}, up to infinity: not finite", (~weights.isfinite()).sum())
    numeric_row("N21", f"{dtype}, up to infinity: negative", (weights < 0).sum())
    numeric_row("N21", f"{dtype}, dt = 0: largest weight", weights[dt[:, 0] == 0].max())
    numeric_row("N21", f"{dtype}: sum of weights and rest, less 1", (weights.sum(dim=1) + behind - 1).abs().max(), 2e-6)


def test_n23_weights_sum_to_one_and_follow_float64(numeric_row):
    counts, scales = [0, 1, 2, 32, 1024, 8192, 65536], [0.0, 1e-12, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e12, 1e30]
    lengths = [1e-10, 1e-4, 1e-2, 1.0, 1e4]
    broken, over, apart, off, slope = [], [], [], [], []
    for count, scale, length in itertools.product(counts, scales, lengths):
        density, dt, colour = torch.rand(2, count) * scale, torch.rand(2, count) * length, torch.rand(2, count)
        weights, behind = sample_weights(density, dt)
        total = weights.double().sum(dim=1)
        broken.append((~(weights >= 0)).sum())
        over.append(total.max() - 1)
        apart.append((total + behind - 1).abs().max())
        if not count:
            continue
        off.append((weights - all_weights(density, dt)).abs().max())
        found = finite_gradients(lambda d, t, c=colour: sample_weights(d, t)[0] * c, density, dt)
        for gradient, exact, other in zip(found, exact_gradients(density, dt, colour), (dt, density)):
            allowed = (1e-2 * exact.abs() + 1e-7 * other.double()).clamp(min=1e-300)
            slope.append(((gradient - exact).abs() / allowed).max())
    about = "0 to 65536 samples, densities to 1e30, lengths 1e-10 to 1e4"
    numeric_row("N23", f"{about}: not finite or negative", sum(broken))
    numeric_row("N23", f"{about}: sum of weights above 1", torch.stack(over).max(), 2e-6)
    numeric_row("N23", f"{about}: sum of weights and rest, less 1", torch.stack(apart).max(), 2e-6)
    numeric_row("N23", f"{about}: error of a weight", torch.stack(off).max(), 1e-6)
    share = torch.stack(slope).max()
    numeric_row("N23", f"{about}: error of the gradient, share of 1e-2 of it + 1e-7 of the other factor", share, 1.0)


@pytest.mark.parametrize("total", [1e-3, 8.0, 100.0])
def test_n23_values_and_gradients_against_one_sample_at_a_time(total, numeric_row):
    density, dt = torch.rand(3, 200) * total / 100, torch.rand(3, 200)
    assert (all_weights(density, dt) - slow_weights(density, dt)).abs().max() <= 1e-14
    worst = (sample_weights(density, dt)[0] - slow_weights(density, dt)).abs().max()
    numeric_row("N23", f"200 samples of {total} together, one at a time: error of a weight", worst, 1e-6)
    colour = torch.rand(3, 200)
    gradients = finite_gradients(lambda d, t: sample_weights(d, t)[0] * colour, density, dt)
    exact = finite_gradients(lambda d, t: sample_weights(d, t)[0] * colour, density.double(), dt.double())
    for mine, theirs, by_hand in zip(gradients, exact, exact_gradients(density, dt, colour)):
        torch.testing.assert_close(theirs, by_hand, rtol=1e-9, atol=1e-12)
        assert ((mine - theirs).abs() <= 1e-2 * theirs.abs() + 1e-7 * dt.maximum(density)).all()


def test_n24_an_opaque_spike_takes_all(numeric_row):
    density = torch.zeros(1, 128)
    density[0, 77] = 1e10
    weights, behind = sample_weights(density, torch.full((1, 128), 0.1))
    worst = (weights - torch.nn.functional.one_hot(torch.tensor([77]), 128)).abs().max()
    numeric_row("N24", "a density of 1e10 in one of 128 places: error of a weight", worst, 1e-5)
    assert weights[0, 77] == 1
    assert weights.sum() == 1
    assert behind == 0


def test_thin_samples_before_a_thick_one_keep_their_weight():
    # x = 1e-6 in front of an opaque wall: an inclusive sum minus its last term would lose it
    weights, _ = sample_weights(torch.tensor([[1e-6, 500.0, 1.0]]), torch.ones(1, 3))
    assert weights[0, 0].item() == pytest.approx(1e-6, rel=1e-5)
    assert weights[0, 1].item() == pytest.approx(1.0, rel=1e-5)
    assert weights[0, 2] == 0


def test_n25_closed_form_of_two_equal_samples(numeric_row):
    # weight of the second of two samples of thickness d: exp(-d) (1 - exp(-d)) = expm1(d) exp(-2 d)
    d = torch.exp2(torch.arange(-24.0, 6.0))
    weights, _ = sample_weights(d[:, None].repeat(1, 2), torch.ones(len(d), 2))
    truth = torch.expm1(d.double()) * torch.exp(-2 * d.double())
    numeric_row("N25", "d = 2^-24 to 2^5: relative error", ((weights[:, 1] - truth).abs() / truth).max(), 1e-6)


@pytest.mark.parametrize("counts", [[0, 3, 0, 0, 5, 0], [0, 0, 0]])
def test_n26_rays_without_samples_show_the_background(counts, numeric_row):
    counts = torch.tensor(counts)
    background = torch.rand(len(counts), 3)
    dt = (torch.arange(5) < counts[:, None]).float()
    density = torch.rand(len(counts), 5).requires_grad_()
    rgb = torch.rand(len(counts), 5, 3).requires_grad_()
    weights, _ = sample_weights(density, dt)
    colour = composite_colour(weights, rgb, background)
    colour.sum().backward()
    empty = counts == 0
    broken = (colour[empty] != background[empty]).sum() + (weights.sum(dim=1)[empty] != 0).sum()
    broken += (density.grad[empty] != 0).sum() + (rgb.grad[empty] != 0).sum()
    numeric_row("N26", f"{counts.tolist()} samples: colours, opacities or gradients of empty rays that differ", broken)


@pytest.mark.parametrize(("rays", "samples"), [(0, 0), (0, 4), (3, 0)])
def test_n26_empty_shapes(rays, samples, numeric_row):
    density = torch.zeros(rays, samples, requires_grad=True)
    weights, behind = sample_weights(density, torch.zeros(rays, samples))
    colour = composite_colour(weights, torch.zeros(rays, samples, 3), torch.ones(rays, 3))
    assert torch.equal(colour, torch.ones(rays, 3))
    assert torch.equal(behind, torch.ones(rays))
    assert not expected_depth(weights, density)[1].any()
    assert not median_depth(weights, density)[1].any()
    colour.sum().backward()
    numeric_row("N26", f"{rays} rays of {samples} samples: no gradient", float(density.grad.shape != (rays, samples)))


@pytest.mark.parametrize("dtype", HALVES)
def test_n27_half_inputs_are_upcast(dtype, numeric_row):
    density, dt = (torch.rand(2, 1024) * 8).to(dtype), torch.full((2, 1024), 1e-2).to(dtype)
    weights, _ = sample_weights(density, dt)
    assert weights.dtype == torch.float32
    assert torch.equal(weights, sample_weights(density.float(), dt.float())[0])
    exact = all_weights(density, dt)
    numeric_row("N27", f"{dtype}, 1024 samples: error of a weight", (weights - exact).abs().max(), 1e-6)
    worst = (weights.sum(dim=1) - exact.sum(dim=1)).abs().max()
    numeric_row("N27", f"{dtype}, 1024 samples: error of their sum", worst, 2e-6)
    big, _ = sample_weights(torch.full((1, 4096), 100.0, dtype=dtype), torch.ones(1, 4096, dtype=dtype))
    numeric_row("N27", f"{dtype}, 4096 samples of thickness 100: sum of weights, less 1", (big.sum() - 1).abs())
    rgb, t, sky = torch.rand(2, 1024, 3).to(dtype), torch.rand(2, 1024).to(dtype), torch.ones(2, 3, dtype=dtype)
    halves = weights.to(dtype)
    changes = []
    for half, single in (
        (composite_colour(halves, rgb, sky), composite_colour(halves.float(), rgb.float(), sky.float())),
        (expected_depth(halves, t)[0], expected_depth(halves.float(), t.float())[0]),
        (median_depth(halves, t)[0], median_depth(halves.float(), t.float())[0]),
    ):
        assert half.dtype == torch.float32
        changes.append((half - single).abs().max())
    numeric_row("N27", f"{dtype}, colour and depths: change beside float32", torch.stack(changes).max())


def test_n27_autocast_changes_nothing(numeric_row):
    density, dt, rgb, t = torch.rand(4, 50) * 3, torch.rand(4, 50), torch.rand(4, 50, 3), torch.rand(4, 50)

    def everything():
        weights, behind = sample_weights(density, dt)
        colour = composite_colour(weights, rgb, torch.ones(4, 3))
        return weights, behind, colour, expected_depth(weights, t)[0], median_depth(weights, t)[0]

    plain = everything()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        cast = everything()
    assert all(value.dtype == torch.float32 for value in cast)
    worst = torch.stack([(a - b).abs().max() for a, b in zip(plain, cast)]).max()
    numeric_row("N27", "weights, colour and depths: change under autocast", worst, 1e-6)


def test_t01_composite(numeric_row):
    inputs = torch.rand(64, 50) * 3, torch.rand(64, 50) / 10, torch.rand(64, 50, 3)

    def colour(density, dt, rgb):
        return composite_colour(sample_weights(density, dt)[0], rgb, torch.ones_like(rgb[:, 0]))

    for dtype, error, accepted in zip(LADDER, ladder_errors(colour, *inputs), (1e-6, 1e-3, 8e-3)):
        numeric_row("T01", f"composite, inputs in {dtype}: relative error of the colour", error, accepted)
    numeric_row("T01", "composite: change under autocast", change_under_autocast(colour, *inputs))


@pytest.mark.parametrize("dtype", HALVES)
def test_n27_autocast_changes_no_gradient(dtype, numeric_row):
    inputs = torch.rand(4, 50) * 3, torch.rand(4, 50), torch.rand(4, 50, 3)

    def slopes():
        leaves = [value.clone().requires_grad_() for value in inputs]
        colour = composite_colour(sample_weights(*leaves[:2])[0], leaves[2], torch.ones(4, 3))
        return torch.autograd.grad(colour.square().sum(), leaves)

    with torch.autocast("cpu", enabled=False):
        plain = slopes()
    with torch.autocast("cpu", dtype=dtype):
        worst = max(float((a - b).abs().max()) for a, b in zip(slopes(), plain))
    numeric_row("N27", f"colour, forward and backward inside a {dtype} autocast: change of gradients", worst)


def test_gradients_of_the_colour_equal_differences():
    weights, rgb, background = (torch.rand(size, dtype=torch.float64) / 9 for size in ((2, 4), (2, 4, 3), (2, 3)))
    leaves = [value.requires_grad_() for value in (weights, rgb, background)]
    assert torch.autograd.gradcheck(composite_colour, leaves)


@pytest.mark.parametrize("opacity", [0.0, 1e-12, 1e-4, 9.99e-4])
def test_n28_an_empty_ray_has_no_depth(opacity, numeric_row):
    t = torch.tensor([[5.0], [0.1]])
    weights = torch.tensor([[opacity], [1.0]])  # beside a ray that hits something near
    depth, valid = expected_depth(weights, t)
    alone, alone_valid = expected_depth(weights[:1], t[:1])
    broken = (valid.tolist() != [False, True]) + (depth[0] != math.inf) + alone_valid.sum() + (alone[0] != depth[0])
    numeric_row("N28", f"opacity {opacity}: a depth, or another one in company", broken)
    gradient = finite_gradients(lambda w: torch.where(valid, expected_depth(w, t)[0], 0.0), weights)
    numeric_row("N28", f"opacity {opacity}: gradient of the depth that is not there", gradient[0][0].abs().max())
    assert median_depth(weights, t)[0].tolist() == [math.inf, pytest.approx(0.1)]


def test_n29_two_half_surfaces(numeric_row):
    weights, t = torch.tensor([[0.5, 0.5]]), torch.tensor([[1.0, 10.0]])
    numeric_row("N29", "mean depth of surfaces at 1 and 10 m, from 5.5", abs(expected_depth(weights, t)[0] - 5.5), 1e-6)
    median = float(median_depth(weights, t)[0])
    numeric_row("N29", "median depth, from the nearer surface", min(abs(median - 1), abs(median - 10)))


def test_half_of_the_light_never_stopped_has_no_median():
    depth, valid = median_depth(torch.tensor([[0.2, 0.2]]), torch.tensor([[1.0, 2.0]]))
    assert not valid[0]
    assert depth[0] == math.inf


def test_n31_background_is_never_negative_nor_colour_above_one(numeric_row):
    # an opacity that rounding lifted to 1 + 2^-22
    weights = torch.tensor([[0.5, 0.5 + 2.0**-22]])
    for background in (0.0, 1.0):
        colour = composite_colour(weights, torch.ones(1, 2, 3), torch.full((1, 3), background))
        worst = (colour - colour.clamp(0, 1)).abs().max()
        numeric_row("N31", f"opacity 1 + 2^-22 before {background:g}: outside [0, 1] by", worst)


@pytest.mark.parametrize("count", [7, 200, 8192])
def test_n31_white_before_white_is_not_brighter_than_white(count, numeric_row):
    # the opacity and the colour are sums in different orders: they round differently
    outside = []
    for scale, background in itertools.product([0.1, 1.0, 100.0], [0.0, 1.0]):
        weights, _ = sample_weights(torch.rand(100, count) * scale, torch.rand(100, count) * 0.1)
        colour = composite_colour(weights, torch.ones(100, count, 3), torch.full((100, 3), background))
        outside.append((colour - colour.clamp(0, 1)).abs().max())
    numeric_row("N31", f"{count} white samples: outside [0, 1] by", torch.stack(outside).max())


@given(st.integers(0, 10**6), st.integers(1, 300), st.floats(-6, 6), st.floats(-6, 6))
def test_any_picture_is_a_mean_of_its_colours(seed, count, log_density, log_length):
    generator = torch.Generator().manual_seed(seed)
    density, dt, level = (torch.rand(2, count, generator=generator) for _ in range(3))
    weights, behind = sample_weights(density * 10**log_density, dt * 10**log_length)
    background = torch.rand(2, 3, generator=generator)
    colour = composite_colour(weights, level[:, :, None].expand(2, count, 3), background)
    assert (weights >= 0).all() and ((weights.sum(dim=1) + behind - 1).abs() <= 2e-6).all()
    everything = torch.cat([level[:, :, None].expand(2, count, 3), background[:, None]], dim=1)
    assert (colour >= everything.amin(dim=1) - 1e-5).all() and (colour <= everything.amax(dim=1) + 1e-5).all()
    assert (colour >= 0).all() and (colour <= 1).all()


def test_n23_batch_of_one_equals_batch_of_many(numeric_row):
    density, dt = torch.rand(64, 30) * 5, torch.rand(64, 30)
    together = sample_weights(density, dt)[0]
    alone = torch.cat([sample_weights(density[i : i + 1], dt[i : i + 1])[0] for i in range(64)])
    numeric_row("N23", "64 rays at once or one at a time: change of a weight", (together - alone).abs().max(), 1e-6)


def test_gradients_against_finite_differences():
    density = torch.rand(2, 6, dtype=torch.float64).requires_grad_()
    dt = (torch.rand(2, 6, dtype=torch.float64) + 0.1).requires_grad_()
    rgb = torch.rand(2, 6, 3, dtype=torch.float64).requires_grad_()
    background = torch.rand(2, 3, dtype=torch.float64).requires_grad_()

    def picture(density, dt, rgb, background):
        return composite_colour(sample_weights(density, dt)[0], rgb, background)

    assert torch.autograd.gradcheck(picture, (density, dt, rgb, background))


@pytest.mark.parametrize("loss", [torch.nn.functional.mse_loss, torch.nn.functional.huber_loss])
def test_n32_colour_losses_have_finite_gradients_at_zero(loss, numeric_row):
    broken = 0
    for prediction, target in ((0.0, 0.0), (0.5, 0.5), (1.0, 0.0)):
        colour = torch.full((3, 3), prediction, requires_grad=True)
        loss(colour, torch.full_like(colour, target)).backward()
        broken += (~colour.grad.isfinite()).sum()
    numeric_row("N32", f"{loss.__name__}, prediction and truth equal, or 0: gradients that are not finite", broken)
