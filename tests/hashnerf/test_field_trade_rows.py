"""What lower precision and a smaller field cost: errors beside float64, decibels beside a large field."""

import dataclasses
import math

import pytest
import torch
from torch import Tensor

from hashnerf.cameras import image_rays
from hashnerf.field import Field, FieldConfig
from hashnerf.fit import FieldFit, FitConfig, RayBatch, render_batch
from hashnerf.marching import MarchSettings
from hashnerf.occupancy import OccupancyConfig, OccupancyGrid
from hashnerf.ray_box import intersect_box
from hashnerf.rays import Rays
from tests.hashnerf.analytic_scene import BOX, ring_of_cameras
from tests.hashnerf.numerics import LADDER, change_under_autocast, relative_error

MARCH = MarchSettings(candidates=48, even_distance=5.0)
CUBE = torch.tensor([[-0.7, -0.7, 0.1], [0.7, 0.7, 1.5]])
AROUND_CUBE = torch.tensor([[-1.0, -1.0, -0.2], [1.0, 1.0, 1.8]])
# the finest lattice has more vertices than the small table has entries
SMALL = FieldConfig(
    levels=8, log2_table_size=14, base_resolution=8, finest_resolution=32, hidden_width=32, initial_thickness=1.0
)
LARGE = dataclasses.replace(SMALL, levels=16, log2_table_size=19)


@pytest.fixture
def lively_field() -> Field:
    """A field whose table holds numbers of the size that training gives them."""
    torch.manual_seed(0)
    field = Field(FieldConfig(levels=8, log2_table_size=12, base_resolution=8, finest_resolution=64), BOX)
    with torch.no_grad():
        field.hash_grid.table.uniform_(-0.5, 0.5)
    return field


def test_t01_field(lively_field, numeric_row):
    field = lively_field
    generator = torch.Generator().manual_seed(0)
    positions = BOX[0] + (BOX[1] - BOX[0]) * torch.rand(500, 3, generator=generator)
    directions = torch.nn.functional.normalize(torch.randn(500, 3, generator=generator), dim=1)

    def seen(x: Tensor, d: Tensor) -> Tensor:
        density, rgb = field(x, d)
        return torch.cat([density.log()[:, None], rgb], dim=1)

    with torch.no_grad():
        change = change_under_autocast(seen, positions, directions)
        numeric_row("T01", "field: change of log-density and colour under autocast", change)
        state = {name: value.clone() for name, value in field.state_dict().items()}
        reference = seen_in(field.double(), state, seen, positions.double(), directions.double())
        errors = [relative_error(seen_in(field.to(d), state, seen, positions, directions), reference) for d in LADDER]
    for dtype, error, accepted in zip(LADDER, errors, (1e-5, 1e-2, 1e-1)):
        numeric_row("T01", f"field, weights and products in {dtype}: relative error beside float64", error, accepted)
    assert errors == sorted(errors)


def seen_in(field: Field, state: dict, seen, positions: Tensor, directions: Tensor) -> Tensor:
    """What a field in another precision answers, from the weights as they were before any rounding."""
    field.load_state_dict(state)
    with torch.autocast("cpu", enabled=False):
        return seen(positions, directions)


class CubePictures:
    """All rays of a ring of cameras around a cube whose faces shade from edge to edge, before white."""

    def __init__(self, cameras: int, size: int, turn: float = 0.0):
        ring = ring_of_cameras(cameras, size, turn)
        every = [image_rays(ring, index) for index in range(cameras)]
        self.rays = Rays(torch.cat([r.origins for r in every]), torch.cat([r.directions for r in every]))
        near, _, hit = intersect_box(self.rays.origins, self.rays.directions, CUBE)
        place = (self.rays.origins + self.rays.directions * near[:, None] - CUBE[0]) / (CUBE[1] - CUBE[0])
        self.rgb = torch.where(hit[:, None], place.clamp(0, 1), 1.0)

    def batch(self, rows: Tensor) -> RayBatch:
        return RayBatch(self.rays.select(rows), self.rgb[rows])


def held_out_psnr(shape: FieldConfig, steps: int) -> float:
    """Train a field on the cube and return the PSNR (dB) of unseen views."""
    torch.manual_seed(0)
    known, unseen = CubePictures(24, 24), CubePictures(4, 24, turn=0.2)
    config = FitConfig(rays=256, batch_samples=2048, occupancy_every=8)
    grid = OccupancyGrid(OccupancyConfig(cell=0.2), AROUND_CUBE)
    fit = FieldFit(Field(shape, AROUND_CUBE), grid, config, MARCH, steps)
    for step in range(steps):
        if step % config.occupancy_every == 0:
            fit.update_occupancy(None)
        generator = fit.generator(step)
        rows = torch.randint(len(known.rays), (fit.rays_wanted(),), generator=generator)
        fit.step(step, known.batch(rows), generator)
    truth = unseen.batch(torch.arange(len(unseen.rays)))
    with fit.average.applied(), torch.no_grad():
        error = (render_batch(fit.field, truth, fit.occupancy, MARCH).rgb - truth.rgb).square().mean()
    return -10 * math.log10(float(error))


def test_t07_a_small_field_shows_a_cube_as_well_as_a_large_one(numeric_row):
    small, large = (held_out_psnr(shape, steps=110) for shape in (SMALL, LARGE))
    about = f"2^14 entries x 8 levels {small:.1f} dB, 2^19 x 16 {large:.1f} dB"
    numeric_row("T07", f"a cube, unseen views: {about}: decibels lost", max(large - small, 0.0), 0.3)
    assert small > 20
