"""What an empty scene and a small one cost beside a full one: samples and cells follow what there is."""

import torch

from hashnerf.field import Field, FieldConfig
from hashnerf.fit import EMPTY_RAYS, EMPTY_TURNS, FieldFit, FitConfig
from hashnerf.marching import MarchSettings
from hashnerf.occupancy import OccupancyConfig, OccupancyGrid
from hashnerf.render import render_images
from tests.hashnerf.analytic_scene import BOX, Pictures, ring_of_cameras

MARCH = MarchSettings(candidates=64, even_distance=5.0)
NO_BALL = torch.tensor([[-1.0]])


def one_box(positions):
    """A box of 0.6 m in the middle of the scene."""
    middle = torch.tensor([0.0, 0.0, 0.5])
    return torch.where(((positions - middle).abs() < 0.3).all(dim=1), 20.0, 0.0)


def city(positions):
    """Boxes of 0.6 m and of all heights, 0.6 m apart."""
    lot, place = (positions[:, :2] / 1.2).floor(), positions[:, :2] % 1.2
    height = 0.6 + 1.4 * ((lot[:, 0] * 0.618 + lot[:, 1] * 0.755) % 1)
    return torch.where((place < 0.6).all(dim=1) & (positions[:, 2] < height), 20.0, 0.0)


def seen_grid(density) -> OccupancyGrid:
    grid = OccupancyGrid(OccupancyConfig(cell=0.2, warmup=4), BOX)
    for _ in range(8):
        grid.update(lambda positions: density(positions)[None])
    return grid


def empty_fit(steps: int) -> tuple[FieldFit, Pictures]:
    """A fit whose field is so thin that the grid is empty after its warm-up."""
    torch.manual_seed(0)
    shape = FieldConfig(
        levels=5,
        log2_table_size=13,
        base_resolution=6,
        finest_resolution=64,
        hidden_width=32,
        initial_thickness=1e-3,
        direction_degree=1,
    )
    config = FitConfig(rays=256, batch_samples=4096, occupancy_every=4)
    grid = OccupancyGrid(OccupancyConfig(cell=0.3), BOX)
    fit = FieldFit(Field(shape, BOX, 1), grid, config, MARCH, steps)
    for _ in range(grid.config.warmup):
        fit.update_occupancy(NO_BALL)
    return fit, Pictures(ring_of_cameras(8, 24))


def test_t04_an_empty_scene_takes_no_samples(numeric_row):
    grid = seen_grid(lambda positions: torch.zeros(len(positions)))
    cameras = ring_of_cameras(2, 24)
    sky = torch.tensor([0.2, 0.4, 0.6])
    for samples in (0, 48):
        seen = render_images(
            cameras,
            [0],
            lambda x, d, ray: (torch.ones(len(x)), torch.ones(len(x), 3)),
            grid,
            MarchSettings(samples=samples),
            lambda rays: sky.expand(len(rays), 3),
        )
        numeric_row("T04", f"an empty grid, march.samples {samples}: samples of a picture", seen.samples_evaluated)
        assert torch.equal(seen.rgb, sky.expand(24 * 24, 3))
        assert not seen.depth_valid.any()


def test_t04_training_an_empty_scene_samples_in_one_step_of_sixteen(numeric_row):
    fit, pictures = empty_fit(steps=2 * EMPTY_TURNS)
    assert fit.occupancy.is_empty()
    wrong = 0
    for step in range(2 * EMPTY_TURNS):
        wanted = fit.rays_wanted()
        generator = fit.generator(step)
        taken = fit.step(step, pictures.draw(step, wanted, generator), generator)["samples"]
        # no sample to a ray must not ask for ever more rays
        rays = EMPTY_RAYS * fit.config.rays if step else fit.config.rays
        wrong += (taken > 0) != (step % EMPTY_TURNS == 0) or wanted != rays
    numeric_row("T04", f"{2 * EMPTY_TURNS} steps of training: steps with other samples or rays than meant", wrong)


def test_t04_a_field_comes_back_from_an_empty_grid(numeric_row):
    steps = 12 * EMPTY_TURNS
    fit, pictures = empty_fit(steps)
    for step in range(steps):
        if step % fit.config.occupancy_every == 0:
            fit.update_occupancy(torch.tensor([[-1.0], [1.0]]))
        generator = fit.generator(step)
        fit.step(step, pictures.draw(step, fit.rays_wanted(), generator), generator)
    occupied = fit.occupancy.occupied_fraction()
    numeric_row("T04", f"trained on pictures of a scene: still empty after {steps} steps", occupied == 0)


def test_t05_samples_and_cells_follow_what_there_is(numeric_row):
    cameras = ring_of_cameras(4, 24)
    taken, cells = [], []
    for density in (one_box, city):
        grid = seen_grid(density)
        cells.append(grid.occupied_fraction())
        images = [
            render_images(
                cameras,
                [index],
                lambda x, d, ray, density=density: (density(x), torch.ones(len(x), 3)),
                grid,
                MARCH,
            )
            for index in range(len(cameras))
        ]
        taken.append(sum(image.samples_evaluated for image in images) / (len(cameras) * 24 * 24))
    about = f"one box beside a city ({cells[0]:.2%} of {cells[1]:.2%} of the cells occupied"
    numeric_row("T05", f"{about}): share of its occupied cells", cells[0] / cells[1], 0.25)
    numeric_row("T05", f"the same: share of its {taken[1]:.1f} samples a ray", taken[0] / taken[1], 0.25)
    assert cells[0] > 0 and taken[0] > 0
