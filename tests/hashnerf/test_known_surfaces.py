"""What a batch may know besides colours: distances of surfaces and points where nothing stands."""

import dataclasses

import pytest
import torch

from hashnerf.errors import UserError
from hashnerf.field import Field, FieldConfig
from hashnerf.fit import FieldFit, FitConfig, RayBatch, render_batch
from hashnerf.known_surfaces import distance_error, standing
from hashnerf.marching import MarchSettings
from hashnerf.occupancy import OccupancyConfig, OccupancyGrid
from hashnerf.rays import Rays
from hashnerf.render import Rendering

BOX = torch.tensor([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
FIELD = FieldConfig(levels=4, log2_table_size=12, base_resolution=8, finest_resolution=32, hidden_width=16)
MARCH = MarchSettings(candidates=64, even_distance=2.0, near=0.01, samples=0)
CONFIG = FitConfig(rays=128, occupancy_every=4, learning_rate=0.05)


def build(**changes) -> FieldFit:
    torch.manual_seed(0)
    grid = OccupancyGrid(OccupancyConfig(cell=0.2, warmup=100), BOX)
    return FieldFit(Field(FIELD, BOX), grid, dataclasses.replace(CONFIG, **changes), MARCH, 60)


def downward(count: int, generator: torch.Generator, **known) -> RayBatch:
    """Rays straight down through the box, which see grey."""
    place = torch.cat([torch.rand(count, 2, generator=generator), torch.full((count, 1), 1.5)], dim=1)
    down = torch.tensor([0.0, 0.0, -1.0]).expand(count, 3).contiguous()
    return RayBatch(Rays(place, down), torch.full((count, 3), 0.5), **known)


def train(fit: FieldFit, steps: int = 60, **known) -> FieldFit:
    for step in range(steps):
        if step % 4 == 0:
            fit.update_occupancy(None)
        generator = fit.generator(step)
        fit.step(step, downward(128, generator, **known), generator)
    return fit


def rendering(depth: list[float], valid: list[bool]) -> Rendering:
    far = torch.tensor(depth)
    return Rendering(torch.zeros(len(far), 3), far, far, torch.tensor(valid), torch.ones(len(far)), 0)


def test_n53_the_distance_error_by_hand(numeric_row):
    seen = rendering([1.0, 2.0, 3.0, torch.inf], [True, True, True, False])
    # errors of 0 and 1 m beyond the bend at 5 cm: 1 - 0.025; the third is not known, the fourth hits nothing
    wanted = torch.tensor([1.0, 3.0, torch.nan, 2.0])
    assert float(distance_error(seen, wanted)) == pytest.approx((0.0 + 0.975) / 2)
    numeric_row("N53", "no distance known: its mean error", distance_error(seen, torch.full((4,), torch.nan)))


def test_n32_the_distance_error_has_a_finite_gradient_beside_rays_that_hit_nothing(numeric_row):
    depth = torch.tensor([1.0, torch.inf], requires_grad=True)
    seen = dataclasses.replace(rendering([1.0, 1.0], [True, False]), depth=depth)
    distance_error(seen, torch.tensor([1.5, torch.nan])).backward()
    worst = (depth.grad - torch.tensor([-1.0, 0.0])).abs().max()
    numeric_row("N32", "distances, one of them infinite: error of the gradient", worst, 1e-6)


def test_n32_losses_of_what_is_known_have_finite_gradients_where_nothing_is_wrong(numeric_row):
    depth = torch.tensor([0.0, 2.0], requires_grad=True)
    seen = dataclasses.replace(rendering([0.0, 2.0], [True, True]), depth=depth)
    distance_error(seen, torch.tensor([0.0, 2.0])).backward()
    broken = (~depth.grad.isfinite()).sum()
    # e^-200 is zero in float32, e^200 far beyond what the field allows itself
    for shift in (-200.0, 0.0, 200.0):
        field = build().field
        field.log_initial_density += shift
        loss = standing(field, torch.full((5, 3), 0.5))
        loss.backward()
        gradients = [parameter.grad for parameter in field.parameters() if parameter.grad is not None]
        broken += (~loss.isfinite()) + sum((~gradient.isfinite()).sum() for gradient in gradients)
        assert gradients
    numeric_row("N32", "equal distances, and points in air, fog and rock: not finite", broken)


def test_known_distances_put_the_surface_there():
    distance = torch.full((128,), 1.2)
    error = []
    for known in ({}, {"distance": distance}):
        fit = train(build(distance_weight=1.0), **known)
        with torch.no_grad():
            probe = downward(128, torch.Generator().manual_seed(1))
            seen = render_batch(fit.field, probe, fit.occupancy, MARCH)
        error.append(float((seen.depth - 1.2).abs().mean()))
    assert error[1] < 0.03 and error[1] < error[0] / 3


def test_empty_points_clear_the_air_there_and_nowhere_else():
    generator = torch.Generator().manual_seed(0)
    empty = torch.rand(400, 3, generator=generator) * torch.tensor([1.0, 1.0, 0.4]) + torch.tensor([0.0, 0.0, 0.5])
    plain, cleared = train(build()), train(build(empty_weight=0.3), empty=empty)
    inside = torch.rand(500, 3, generator=generator) * torch.tensor([1.0, 1.0, 0.3]) + torch.tensor([0.0, 0.0, 0.55])
    with torch.no_grad():
        before, after = (float(fit.field.density(inside)[0].mean()) for fit in (plain, cleared))
        probe = downward(128, torch.Generator().manual_seed(1))
        seen = render_batch(cleared.field, probe, cleared.occupancy, MARCH)
    assert after < before / 5
    assert (seen.rgb - 0.5).abs().mean() < 0.05, "what the rays see moved to where something may stand"


def test_fog_in_the_colours_of_the_background_goes_where_opacity_has_a_price():
    # the rays see grey, and so is the background: fog and none are the same for the pictures
    opacity = []
    for weight in (0.0, 0.1):
        fit = train(build(opacity_weight=weight))
        with torch.no_grad():
            seen = render_batch(fit.field, downward(128, torch.Generator().manual_seed(1)), fit.occupancy, MARCH)
        opacity.append(float(seen.opacity.mean()))
        assert (seen.rgb - 0.5).abs().mean() < 0.05
    assert opacity[1] < 0.1 * opacity[0]


def test_further_parameters_are_trained_with_the_field():
    shift = torch.nn.Parameter(torch.zeros(3))
    torch.manual_seed(0)
    grid = OccupancyGrid(OccupancyConfig(cell=0.2), BOX)
    fit = FieldFit(Field(FIELD, BOX), grid, CONFIG, MARCH, 10, further=[{"params": [shift], "start": 0.01}])
    fit.update_occupancy(None)
    batch = downward(64, torch.Generator().manual_seed(0))
    rays = Rays(batch.rays.origins + shift, batch.rays.directions)
    fit.step(0, dataclasses.replace(batch, rays=rays), fit.generator(0))
    assert shift.abs().max() > 0
    assert len(fit.optimizer.param_groups) == 3


@pytest.mark.parametrize("key", ["distance_weight", "empty_weight", "opacity_weight"])
def test_impossible_weights_name_the_key(key):
    with pytest.raises(UserError, match=f"fit.{key}"):
        FitConfig(**{key: -1.0})
