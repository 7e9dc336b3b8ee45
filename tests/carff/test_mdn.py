import math

import pytest
import torch

from carff.beliefs import Belief
from carff.mdn import MDN
from hashnerf.errors import UserError


def beliefs(count: int, size: int, shift: float = 0.0, scale: float = 1.0) -> Belief:
    generator = torch.Generator().manual_seed(count)
    return Belief(
        shift + scale * torch.randn(count, size, generator=generator),
        -2 + torch.randn(count, size, generator=generator),
    )


def small(**changes) -> MDN:
    torch.manual_seed(0)
    return MDN(**{"latent_size": 3, "components": 2, "width": 16, **changes})


@pytest.mark.parametrize("components", [1, 2, 5])
@pytest.mark.parametrize("layers", [1, 2, 3])
def test_any_number_of_components_and_layers(components, layers):
    source = beliefs(7, 3)
    mixture = small(components=components, trunk_layers=layers, head_layers=layers)(source.mean, source.logvar)
    assert mixture.means.shape == mixture.log_sigmas.shape == (7, components, 3)
    torch.testing.assert_close(mixture.log_weights.exp().sum(dim=1), torch.ones(7))


def test_the_default_has_the_layers_of_the_paper():
    # Trunk 16-512-512, two heads 512-512-16, weights 16-512-512-2:
    # 8704 + 262656 + 2 (262656 + 8208) + 8704 + 262656 + 1026 = 1,085,474.
    mdn = MDN(8)
    assert sum(parameter.numel() for parameter in mdn.parameters()) == 1_085_474


def test_output_is_in_the_units_of_the_targets():
    target = beliefs(500, 3, shift=50.0, scale=4.0)
    mdn = small()
    mdn.set_statistics(beliefs(500, 3, shift=-20.0, scale=7.0), target)
    with torch.no_grad():
        for layer in (mdn.mean_head[-1], mdn.sigma_head[-1]):
            layer.weight.zero_()
            layer.bias.zero_()
        mixture = mdn(target.mean, target.logvar)
    # Standardised mean 0 and log-sigma 0: the targets' own mean and spread (of the means, plus the average variance).
    spread = (target.mean.var(dim=0, correction=0) + target.logvar.exp().mean(dim=0)).sqrt()
    torch.testing.assert_close(mixture.means[0, 0], target.mean.mean(dim=0))
    torch.testing.assert_close(mixture.log_sigmas[0, 0].exp(), spread)


def test_standardised_inputs_make_shift_and_scale_irrelevant():
    source, target = beliefs(100, 3), beliefs(100, 3)
    moved = Belief(100 + 10 * source.mean, source.logvar)
    results = []
    for inputs in (source, moved):
        mdn = small()
        mdn.set_statistics(inputs, target)
        results.append(mdn(inputs.mean, inputs.logvar).means)
    torch.testing.assert_close(results[0], results[1], rtol=1e-3, atol=1e-4)


def test_a_dimension_that_never_varies_does_not_blow_up_the_noise_on_it():
    source = Belief(beliefs(100, 3).mean, torch.full((100, 3), -2.0))
    mdn = small()
    mdn.set_statistics(source, source)
    with torch.no_grad():
        still = mdn(source.mean, source.logvar).means
        noisy = mdn(source.mean, source.logvar + 0.01).means
    assert (noisy - still).abs().max() < 0.1 * still.std()


def test_constant_targets_keep_finite_statistics():
    constant = Belief(torch.ones(10, 3), torch.full((10, 3), -math.inf))
    mdn = small()
    mdn.set_statistics(beliefs(10, 3), constant)
    mixture = mdn(torch.randn(4, 3), torch.randn(4, 3))
    assert torch.isfinite(mixture.means).all() and torch.isfinite(mixture.log_sigmas).all()


def test_rows_do_not_depend_on_their_batch():
    source = beliefs(64, 3)
    mdn = small()
    whole = mdn(source.mean, source.logvar)
    alone = mdn(source.mean[5:6], source.logvar[5:6])
    torch.testing.assert_close(whole.means[5:6], alone.means, rtol=1e-5, atol=1e-6)


def test_statistics_travel_with_the_weights():
    first, second = small(), MDN(3, 2, 16)
    first.set_statistics(beliefs(50, 3, shift=5.0), beliefs(50, 3, shift=-5.0))
    second.load_state_dict(first.state_dict())
    source = beliefs(6, 3)
    assert torch.equal(first(source.mean, source.logvar).means, second(source.mean, source.logvar).means)


def test_the_density_is_float32_under_autocast():
    source = beliefs(4, 3)
    mdn = small()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        mixture = mdn(source.mean, source.logvar)
    assert mixture.means.dtype == mixture.log_sigmas.dtype == mixture.log_weights.dtype == torch.float32


@pytest.mark.parametrize("name", ["latent_size", "components", "width", "trunk_layers", "head_layers"])
def test_empty_sizes_are_refused_by_name(name):
    with pytest.raises(UserError, match=rf"mdn\.{name} is 0"):
        small(**{name: 0})
