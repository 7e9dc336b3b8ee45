"""The conditioned field: what is refused, what conditions do, and that precision switches change little."""

import dataclasses
import logging

import pytest
import torch

from hashnerf import compiling, mlp
from hashnerf.errors import UserError
from hashnerf.field import Field, FieldConfig
from hashnerf.rays import Rays, unit_directions

BOX = torch.tensor([[-4.0, -2.0, 0.0], [4.0, 2.0, 2.0]])
SMALL = FieldConfig(levels=3, log2_table_size=8, base_resolution=4, finest_resolution=16, hidden_width=16)


def samples(count):
    positions = BOX[0] + torch.rand(count, 3) * (BOX[1] - BOX[0])
    return positions, unit_directions(torch.randn(count, 3))


def trained_like(config=SMALL, size=3):
    field = Field(config, BOX, size)
    torch.nn.init.uniform_(field.hash_grid.table, -1, 1)
    torch.nn.init.normal_(field.beyond.sky.weight, std=0.3)  # zero in a new field
    return field


def test_density_starts_even_and_colour_in_range():
    density, rgb = Field(dataclasses.replace(SMALL, initial_thickness=4.0), BOX)(*samples(500))
    # thickness 4 along the longest side, 8 m
    assert torch.allclose(density, torch.full((500,), 4 / 8), rtol=1e-2)
    assert ((rgb > 0) & (rgb < 1)).all()


def test_the_smallest_number_is_a_density_to_start_from():
    density, _ = Field(dataclasses.replace(SMALL, initial_thickness=5e-324), BOX)(*samples(5))
    assert density.isfinite().all() and (density < 1e-6).all()


def test_conditions_by_row_equal_conditions_by_sample():
    field, (positions, directions) = trained_like(), samples(50)
    rows, index = torch.randn(4, 3), torch.randint(4, (50,))
    by_row = field(positions, directions, rows, index)
    by_sample = field(positions, directions, rows[index])
    for a, b in zip(by_row, by_sample):
        assert torch.equal(a, b)
    rays = Rays(positions, directions)
    assert torch.equal(field.background(rays, rows, index), field.background(rays, rows[index]))


def test_the_condition_reaches_density_colour_and_background():
    field, (positions, directions) = trained_like(), samples(50)
    condition = torch.zeros(50, 3, requires_grad=True)
    density, rgb = field(positions, directions, condition)
    for value in (density, rgb, field.background(Rays(positions, directions), condition)):
        (gradient,) = torch.autograd.grad(value.sum(), condition, retain_graph=True)
        assert gradient.abs().sum() > 0


def test_the_bank_equals_single_conditions():
    field, (positions, _) = trained_like(), samples(40)
    conditions = torch.randn(5, 3)
    bank = field.density_bank(positions, conditions)
    single = torch.stack([field.density(positions, row.expand(40, 3))[0] for row in conditions])
    assert torch.allclose(bank, single, rtol=1e-4)
    plain = trained_like(size=0)
    assert torch.allclose(plain.density_bank(positions)[0], plain.density(positions)[0], rtol=1e-4)


@pytest.mark.parametrize(("size", "given"), [(3, None), (3, 2), (0, 3)])
def test_a_condition_of_another_length_is_refused(size, given):
    field, (positions, directions) = trained_like(size=size), samples(5)
    condition = None if given is None else torch.zeros(5, given)
    with pytest.raises(ValueError, match="length"):
        field(positions, directions, condition)
    with pytest.raises(ValueError, match="length"):
        field.background(Rays(positions, directions), condition)


def test_density_is_bounded_whatever_the_weights_say():
    field, (positions, directions) = trained_like(), samples(20)
    for weight in field.density_network.weights:
        weight.data.mul_(1e6)
    density, rgb = field(positions, directions, torch.ones(20, 3))
    assert density.isfinite().all()
    assert density.max() <= 3.3e6
    (density.sum() + rgb.sum()).backward()
    assert all(parameter.grad.isfinite().all() for parameter in field.parameters() if parameter.grad is not None)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16, torch.float16])
def test_a_cell_is_at_most_opaque_and_can_become_clear_again(dtype):
    # finest cell 8 m / 16 = 0.5 m, thickness 4: 8 per metre
    field = trained_like(dataclasses.replace(SMALL, cell_thickness=4.0))
    raw = torch.tensor([-50.0, -3.0, 5.0, 50.0, 6e4], dtype=dtype, requires_grad=True)
    density = field._bounded_density(raw)
    assert (density.diff() >= 0).all()
    assert density[2] < 8.0 and density[3] < 14.0, "the leak lets 50 e-foldings beyond the bound count as half of one"
    free = torch.exp(raw.detach().float()[1] + field.log_initial_density)
    assert torch.allclose(density[1], free, rtol=0.02), "far below the bound nothing changes"
    (gradient,) = torch.autograd.grad(density.sum(), raw)
    assert gradient.isfinite().all() and (gradient[1:] > 0).all()


def test_no_samples_still_connect_every_parameter():
    field = trained_like()
    density, rgb = field(torch.zeros(0, 3), torch.zeros(0, 3), torch.zeros(1, 3), torch.zeros(0, dtype=torch.int64))
    beyond = field.background(Rays(torch.zeros(0, 3), torch.zeros(0, 3)), torch.zeros(0, 3))
    (density.sum() + rgb.sum() + beyond.sum()).backward()
    for parameter in field.parameters():
        assert (parameter.grad == 0).all()


def test_bfloat16_networks_are_close(monkeypatch):
    monkeypatch.setattr(mlp, "multiplies_bfloat16", lambda device_type: True)
    exact = trained_like()
    low = Field(dataclasses.replace(SMALL, mlp_dtype="bfloat16"), BOX, 3)
    low.load_state_dict(exact.state_dict())
    positions, directions = samples(500)
    condition = torch.randn(500, 3)
    density, rgb = exact(positions, directions, condition)
    low_density, low_rgb = low(positions, directions, condition)
    assert low_density.dtype == low_rgb.dtype == torch.float32
    assert (low_density / density).log().abs().max() < 0.1
    assert (low_rgb - rgb).abs().max() < 0.05


def test_autocast_outside_changes_nothing():
    field, (positions, directions) = trained_like(), samples(30)
    condition = torch.randn(30, 3)

    def everything():
        beyond = field.background(Rays(positions, directions), condition)
        return [*field(positions, directions, condition), beyond, field.density_bank(positions, condition)]

    plain = everything()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        cast = everything()
    for a, b in zip(plain, cast):
        assert torch.equal(a, b)


def test_without_a_compiler_the_field_still_works(monkeypatch, caplog):
    def broken(*_, **__):
        raise RuntimeError("no compiler on this machine\nand a long trace")

    compiling._compiler_works.cache_clear()
    monkeypatch.setattr(torch, "compile", broken)
    with caplog.at_level(logging.WARNING):
        compiled = Field(dataclasses.replace(SMALL, compile=True), BOX)
        plain = Field(SMALL, BOX)
        plain.load_state_dict(compiled.state_dict())
        positions, directions = samples(20)
        for _ in range(2):
            assert torch.equal(compiled(positions, directions)[0], plain(positions, directions)[0])
    assert [record.message for record in caplog.records] == [
        "torch.compile does not work here, running without it: no compiler on this machine"
    ]
    compiling._compiler_works.cache_clear()


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("levels", -1),
        ("features_per_level", 3),
        ("log2_table_size", 3),
        ("finest_resolution", 8),
        ("direction_degree", 5),
        ("geometry_features", -1),
        ("initial_thickness", 0.0),
        ("initial_thickness", 768.0),
        ("cell_thickness", 0.0),
        ("hidden_width", 0),
    ],
)
def test_impossible_configs_name_the_key(key, value):
    with pytest.raises(UserError, match=f"field.{key} is"):
        FieldConfig(**{key: value})
