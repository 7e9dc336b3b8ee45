"""Volume rendering at the extremes, against closed forms and a slow float64 reference."""

import itertools
import math

import pytest
import torch

from hashnerf.compositing import composite_colour, expected_depth, median_depth, sample_weights
from tests.hashnerf.numerics import finite_gradients


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


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_extremes_of_density_and_length(dtype):
    sigma = torch.tensor([0.0, 1e-12, 1.0, 1e6, 1e30, 1e38, math.inf], dtype=dtype)
    length = torch.tensor([0.0, 1e-10, 1e-4, 1.0, 1e10, math.inf], dtype=dtype)
    pairs = torch.tensor(list(itertools.product(sigma.tolist(), length.tolist())), dtype=dtype)
    density, dt = pairs[:, :1].repeat(1, 3), pairs[:, 1:].repeat(1, 3)
    weights, behind = sample_weights(density, dt)
    assert weights.isfinite().all()
    assert (weights >= 0).all()
    assert (weights.sum(dim=1) + behind - 1).abs().max() < 2e-6
    assert (weights[dt[:, 0] == 0] == 0).all(), "a sample without length must contribute exactly nothing"
    finite_gradients(lambda d, t: sample_weights(d, t)[0].sum(dim=1), density, dt)


@pytest.mark.parametrize("count", [0, 1, 2, 32, 1024, 8192, 65536])
@pytest.mark.parametrize("scale", [0.0, 1e-12, 1e-6, 1e-3, 1.0, 1e3, 1e12, 1e30])
def test_weights_sum_to_one_with_what_passes(count, scale):
    for length in (1e-10, 1e-4, 1e-2, 1.0, 1e4):
        density = torch.rand(2, count) * scale
        dt = torch.rand(2, count) * length
        weights, behind = sample_weights(density, dt)
        assert (weights >= 0).all()
        total = weights.double().sum(dim=1)
        assert (total <= 1 + 2e-6).all()
        assert (total + behind - 1).abs().max() <= 2e-6


@pytest.mark.parametrize("total", [1e-3, 8.0, 100.0])
def test_values_and_gradients_against_float64(total):
    density, dt = torch.rand(3, 200) * total / 100, torch.rand(3, 200)
    assert (sample_weights(density, dt)[0] - slow_weights(density, dt)).abs().max() <= 1e-6
    colour = torch.rand(3, 200)
    gradients = finite_gradients(lambda d, t: sample_weights(d, t)[0] * colour, density, dt)
    exact = finite_gradients(lambda d, t: sample_weights(d, t)[0] * colour, density.double(), dt.double())
    assert ((gradients[0] - exact[0]).abs() <= 1e-2 * exact[0].abs() + 1e-7 * dt).all()
    assert ((gradients[1] - exact[1]).abs() <= 1e-2 * exact[1].abs() + 1e-7 * density).all()


def test_an_opaque_spike_takes_all():
    density = torch.zeros(1, 128)
    density[0, 77] = 1e10
    weights, behind = sample_weights(density, torch.full((1, 128), 0.1))
    assert weights[0, 77] == 1
    assert weights.sum() == 1
    assert behind == 0


def test_thin_samples_before_a_thick_one_keep_their_weight():
    # x = 1e-6 in front of an opaque wall: an inclusive sum minus its last term would lose it
    weights, _ = sample_weights(torch.tensor([[1e-6, 500.0, 1.0]]), torch.ones(1, 3))
    assert weights[0, 0].item() == pytest.approx(1e-6, rel=1e-5)
    assert weights[0, 1].item() == pytest.approx(1.0, rel=1e-5)
    assert weights[0, 2] == 0


def test_closed_form_of_two_equal_samples():
    # weight of the second of two samples of thickness d: exp(-d) (1 - exp(-d)) = expm1(d) exp(-2 d)
    d = torch.exp2(torch.arange(-24.0, 5.0))
    weights, _ = sample_weights(d[:, None].repeat(1, 2), torch.ones(len(d), 2))
    truth = torch.expm1(d.double()) * torch.exp(-2 * d.double())
    assert ((weights[:, 1] - truth).abs() <= 1e-6 * truth).all()


def test_rays_without_samples_show_the_background():
    background = torch.rand(6, 3)
    counts = torch.tensor([0, 3, 0, 0, 5, 0])
    dt = (torch.arange(5) < counts[:, None]).float()
    density = torch.rand(6, 5).requires_grad_()
    rgb = torch.rand(6, 5, 3)
    weights, _ = sample_weights(density, dt)
    colour = composite_colour(weights, rgb, background)
    assert torch.equal(colour[counts == 0], background[counts == 0])
    assert (weights.sum(dim=1)[counts == 0] == 0).all()
    colour.sum().backward()
    assert (density.grad[counts == 0] == 0).all()


@pytest.mark.parametrize(("rays", "samples"), [(0, 0), (0, 4), (3, 0)])
def test_empty_shapes(rays, samples):
    density = torch.zeros(rays, samples, requires_grad=True)
    weights, behind = sample_weights(density, torch.zeros(rays, samples))
    colour = composite_colour(weights, torch.zeros(rays, samples, 3), torch.ones(rays, 3))
    assert torch.equal(colour, torch.ones(rays, 3))
    assert torch.equal(behind, torch.ones(rays))
    assert not expected_depth(weights, density)[1].any()
    assert not median_depth(weights, density)[1].any()
    colour.sum().backward()
    assert density.grad.shape == (rays, samples)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_inputs_are_upcast(dtype):
    density, dt = (torch.rand(2, 1024) * 8).to(dtype), torch.full((2, 1024), 1e-2).to(dtype)
    weights, _ = sample_weights(density, dt)
    assert weights.dtype == torch.float32
    assert torch.equal(weights, sample_weights(density.float(), dt.float())[0])
    big, _ = sample_weights(torch.full((1, 4096), 100.0, dtype=dtype), torch.ones(1, 4096, dtype=dtype))
    assert big.sum() == 1


def test_autocast_changes_nothing():
    density, dt, rgb, t = torch.rand(4, 50) * 3, torch.rand(4, 50), torch.rand(4, 50, 3), torch.rand(4, 50)

    def everything():
        weights, behind = sample_weights(density, dt)
        colour = composite_colour(weights, rgb, torch.ones(4, 3))
        return weights, behind, colour, expected_depth(weights, t)[0], median_depth(weights, t)[0]

    plain = everything()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        cast = everything()
    for a, b in zip(plain, cast):
        assert b.dtype == torch.float32
        assert torch.allclose(a, b, atol=1e-6)


@pytest.mark.parametrize("opacity", [0.0, 1e-12, 1e-4])
def test_an_empty_ray_has_no_depth(opacity):
    t = torch.tensor([[5.0], [0.1]])
    weights = torch.tensor([[opacity], [1.0]])  # beside a ray that hits something near
    depth, valid = expected_depth(weights, t)
    assert valid.tolist() == [False, True]
    assert depth[0] == math.inf
    alone, _ = expected_depth(weights[:1], t[:1])
    assert alone[0] == depth[0]
    gradient = finite_gradients(lambda w: torch.where(valid, expected_depth(w, t)[0], 0.0), weights)
    assert gradient[0][0] == 0


def test_two_half_surfaces():
    weights, t = torch.tensor([[0.5, 0.5]]), torch.tensor([[1.0, 10.0]])
    assert expected_depth(weights, t)[0].item() == pytest.approx(5.5)
    assert median_depth(weights, t)[0].item() in (1.0, 10.0)


def test_half_of_the_light_never_stopped_has_no_median():
    depth, valid = median_depth(torch.tensor([[0.2, 0.2]]), torch.tensor([[1.0, 2.0]]))
    assert not valid[0]
    assert depth[0] == math.inf


def test_background_is_never_negative_nor_colour_above_one():
    # an opacity that rounding lifted to 1 + 2^-22
    weights = torch.tensor([[0.5, 0.5 + 2.0**-22]])
    for background in (0.0, 1.0):
        colour = composite_colour(weights, torch.ones(1, 2, 3), torch.full((1, 3), background))
        assert (colour >= 0).all()
        assert (colour <= 1).all()


def test_batch_of_one_equals_batch_of_many():
    density, dt = torch.rand(64, 30) * 5, torch.rand(64, 30)
    together = sample_weights(density, dt)[0]
    alone = torch.cat([sample_weights(density[i : i + 1], dt[i : i + 1])[0] for i in range(64)])
    assert (together - alone).abs().max() <= 1e-6


def test_gradients_against_finite_differences():
    density = torch.rand(2, 6, dtype=torch.float64).requires_grad_()
    dt = (torch.rand(2, 6, dtype=torch.float64) + 0.1).requires_grad_()
    rgb = torch.rand(2, 6, 3, dtype=torch.float64).requires_grad_()
    background = torch.rand(2, 3, dtype=torch.float64).requires_grad_()

    def picture(density, dt, rgb, background):
        return composite_colour(sample_weights(density, dt)[0], rgb, background)

    assert torch.autograd.gradcheck(picture, (density, dt, rgb, background))


def test_colour_losses_have_finite_gradients_at_zero():
    for prediction, target in ((0.0, 0.0), (0.5, 0.5), (1.0, 0.0)):
        for loss in (torch.nn.functional.mse_loss, torch.nn.functional.huber_loss):
            finite_gradients(
                lambda p, loss=loss, y=target: loss(p, torch.full_like(p, y)), torch.full((3, 3), prediction)
            )
