"""Rendering of analytic scenes: against closed forms, against dense marching, in chunks, and with nothing to see."""

import math

import pytest
import torch

from hashnerf.cameras import Cameras, look_at
from hashnerf.marching import MarchSettings
from hashnerf.occupancy import OccupancyConfig, OccupancyGrid
from hashnerf.ray_box import intersect_box
from hashnerf.rays import Rays, unit_directions
from hashnerf.render import middle_distance, render, render_images
from tests.hashnerf.analytic_scene import ring_of_cameras

BOX = torch.tensor([[-4.0, -4.0, 0.0], [4.0, 4.0, 4.0]])
EVERY = MarchSettings(candidates=256, samples=0)


def grid_of(density, cell=0.25, updates=40):
    grid = OccupancyGrid(OccupancyConfig(cell=cell, warmup=1, turns=1), BOX)
    for _ in range(updates):
        grid.update(lambda positions: density(positions)[None])
    return grid


def field_of(density):
    """Colour by place, so that a wrong place shows."""
    return lambda x, d, ray: (density(x), (x / 8 + 0.5).clamp(0, 1))


def nothing(positions):
    return torch.zeros(len(positions))


def box_scene(positions):
    return torch.where((positions.abs() < 1).all(dim=1), 20.0, 0.0)


def pole_scene(positions):
    return torch.where((positions[:, :2] - 0.13).norm(dim=1) < 0.1, 40.0, 0.0)


def camera(size=24):
    return Cameras(
        pose=look_at(torch.tensor([6.0, 3.0, 3.0]), torch.tensor([0.0, 0.0, 1.0]))[None].float(),
        focal=torch.full((1, 2), size * 1.2),
        centre=torch.full((1, 2), size / 2),
        distortion=torch.zeros(1, 4),
        width=size,
        height=size,
    )


def test_even_fog_against_the_closed_form():
    grid = grid_of(lambda p: torch.full((len(p),), 0.3))
    rays = Rays(torch.tensor([[-9.0, 0.0, 2.0]]), torch.tensor([[1.0, 0.0, 0.0]]))
    seen = render(rays, lambda x, d, i: (torch.full((len(x),), 0.3), torch.ones(len(x), 3)), grid, EVERY)
    # 8 m of fog of 0.3/m: opacity 1 - exp(-2.4); median where exp(-0.3 s) = 1/2, s = 2.31 m behind the entry at 5 m
    assert seen.opacity.item() == pytest.approx(1 - math.exp(-2.4), rel=1e-4)
    assert seen.rgb[0, 0].item() == pytest.approx(1 - math.exp(-2.4), rel=1e-4)
    assert seen.median_depth.item() == pytest.approx(5 + math.log(2) / 0.3, abs=0.04)
    # mean depth: 5 + 1/0.3 - 8 exp(-2.4) / (1 - exp(-2.4))
    mean = 5 + 1 / 0.3 - 8 * math.exp(-2.4) / (1 - math.exp(-2.4))
    assert seen.depth.item() == pytest.approx(mean, abs=0.02)
    assert seen.depth_valid.item()


@pytest.mark.parametrize("scene", [nothing, box_scene, pole_scene])
def test_n44_skipping_equals_dense_marching(scene, numeric_row):
    dense = OccupancyGrid(OccupancyConfig(cell=0.25, warmup=10_000), BOX)
    skipped = grid_of(scene, updates=80)
    background = torch.full((3,), 0.3)
    pictures = [
        render_images(camera(), [0], field_of(scene), grid, EVERY, lambda d: background.expand(len(d), 3))
        for grid in (dense, skipped)
    ]
    difference = (pictures[0].rgb - pictures[1].rgb).abs()
    name = scene.__name__.replace("_", " ")
    numeric_row("N44", f"{name}: mean difference from dense marching", difference.mean(), 2e-3)
    numeric_row("N44", f"{name}: mean square (45 dB)", difference.square().mean(), 10**-4.5)
    if scene is not nothing:  # an empty grid falls back to sampling everything
        assert pictures[1].samples_evaluated < 0.2 * pictures[0].samples_evaluated
        assert pictures[1].opacity.max() > 0.99


def test_n43_thin_poles_are_drawn_as_dense_marching_draws_them(numeric_row):
    # upright poles an eighth of a cell wide, each somewhere inside a cell of its own
    box, half = torch.tensor([[-4.0, -4.0, 0.0], [4.0, 4.0, 0.25]]), 0.25 / 16
    cells = torch.randperm(24 * 24)[:100]
    corners = torch.stack([cells // 24, cells % 24], dim=1) * 0.25 - 3
    centres, density = corners + half + torch.rand(100, 2) * (0.25 - 2 * half), 80.0

    def poles(positions):
        return ((positions[:, None, :2] - centres).abs() < half).all(dim=2).any(dim=1) * density

    dense = OccupancyGrid(OccupancyConfig(cell=0.25, warmup=10_000), box)
    grid = OccupancyGrid(OccupancyConfig(cell=0.25, warmup=1, turns=1, points=4), box)
    for _ in range(64):
        grid.update(lambda positions: poles(positions)[None])
    # four rays from all around through each pole
    angle = torch.rand(400) * 2 * math.pi
    directions = torch.stack([angle.cos(), angle.sin(), torch.zeros(400)], dim=1)
    rays = Rays(
        torch.cat([centres.repeat_interleave(4, dim=0), torch.full((400, 1), 0.1)], dim=1) - directions, directions
    )
    thickness = torch.zeros(400)
    for centre in centres:
        own = torch.stack([torch.cat([centre - half, box[0, 2:]]), torch.cat([centre + half, box[1, 2:]])])
        near, far, _ = intersect_box(rays.origins, rays.directions, own, EVERY.near)
        thickness += (far - near) * density
    white = lambda x, d, ray: (poles(x), torch.ones(len(x), 3))  # noqa: E731
    pictures = [render(rays, white, seen, EVERY) for seen in (dense, grid)]
    errors = [(seen.rgb[:, 0] + torch.expm1(-thickness)).square().mean() for seen in pictures]
    loss = 10 * math.log10(errors[1] / errors[0])
    numeric_row("N43", "rays through 100 poles: loss against dense marching, dB", loss, 0.5)
    assert errors[0] < 0.3 and pictures[1].samples_evaluated < 0.5 * pictures[0].samples_evaluated


def test_n41_an_empty_grid_shows_the_background_until_something_is_dense(numeric_row):
    config = OccupancyConfig(cell=0.25)
    grid = OccupancyGrid(config, BOX)
    for _ in range(300):
        grid.update(lambda positions: nothing(positions)[None])
    background = torch.tensor([0.1, 0.5, 0.9])
    wrong = 0
    for settings in (EVERY, MarchSettings()):
        seen = render_images(camera(), [0], field_of(nothing), grid, settings, lambda d: background.expand(len(d), 3))
        wrong += int((seen.rgb != background).sum()) + int(seen.depth_valid.sum())
    for _ in range(config.turns):  # one update of every cell
        grid.update(lambda positions: box_scene(positions)[None])
    seen = render_images(camera(), [0], field_of(box_scene), grid, EVERY)
    wrong += int(seen.opacity.max() < 0.99) + int(grid.occupied_fraction() > 0.2)
    numeric_row("N41", "300 updates without density: background; then a box: drawn after one full update", wrong)


@pytest.mark.parametrize("scene", [box_scene, pole_scene])
def test_resampled_rendering_is_close_to_dense_marching(scene):
    grid = grid_of(scene, updates=80)
    dense = render_images(camera(), [0], field_of(scene), grid, EVERY)
    few = render_images(camera(), [0], field_of(scene), grid, MarchSettings(candidates=256, samples=48))
    assert (dense.rgb - few.rgb).square().mean() < 2e-3
    assert (dense.depth_valid == few.depth_valid).float().mean() > 0.97


def test_n26_rays_that_meet_nothing(numeric_row):
    rays = Rays(torch.tensor([[0.0, 0.0, 9.0], [0.0, 0.0, 9.0]]), torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]))
    weight = torch.tensor(2.0, requires_grad=True)

    def field_fn(x, d, ray):
        return weight * torch.ones(len(x)), weight * torch.ones(len(x), 3) / 4

    grid = OccupancyGrid(OccupancyConfig(cell=1.0), BOX)
    sky = torch.tensor([[0.1, 0.2, 0.3]])
    seen = render(rays, field_fn, grid, EVERY, lambda d: sky.expand(len(d), 3))
    wrong = (seen.rgb[0] != sky[0]).sum() + (seen.opacity[0] != 0)
    numeric_row("N26", "a ray beside the box: another colour than the sky's, or opaque", wrong)
    assert seen.depth_valid.tolist() == [False, True]
    alone = render(rays.select(slice(0, 1)), field_fn, grid, EVERY, lambda d: sky.expand(len(d), 3))
    assert alone.samples_evaluated == 0
    alone.rgb.sum().backward()
    assert weight.grad == 0, "a step without samples must still give every parameter a gradient"


def test_n26_no_rays(numeric_row):
    seen = render(Rays(torch.zeros(0, 3), torch.zeros(0, 3)), field_of(nothing), grid_of(nothing, updates=1), EVERY)
    numeric_row("N26", "no rays: colours of another shape", float(seen.rgb.shape != (0, 3)))


def test_the_field_sees_the_right_ray():
    rays = Rays(torch.randn(40, 3) + torch.tensor([0.0, 0.0, 2.0]), unit_directions(torch.randn(40, 3)))

    def field_fn(x, d, ray):
        along = ((x - rays.origins[ray]) * d).sum(dim=1, keepdim=True)
        assert torch.equal(d, rays.directions[ray])
        assert torch.allclose(rays.origins[ray] + along * d, x, atol=1e-4)
        assert (ray.diff() >= 0).all()
        return torch.ones(len(x)), torch.ones(len(x), 3)

    for settings in (EVERY, MarchSettings()):
        render(rays, field_fn, OccupancyGrid(OccupancyConfig(cell=1.0), BOX), settings, None, torch.Generator())


def test_chunks_do_not_change_the_picture(monkeypatch):
    grid = grid_of(box_scene)
    whole = render_images(camera(), [0], field_of(box_scene), grid, EVERY)
    monkeypatch.setattr("hashnerf.render.SAMPLES_AT_ONCE", 100)
    pieces = render_images(camera(), [0], field_of(box_scene), grid, EVERY, rays_at_once=77)
    assert torch.allclose(whole.rgb, pieces.rgb, atol=1e-6)
    assert torch.equal(whole.depth_valid, pieces.depth_valid)
    assert whole.samples_evaluated == pieces.samples_evaluated
    assert whole.rgb.shape == (24 * 24, 3)


@pytest.mark.parametrize("supersample", [1, 2])
def test_pictures_rendered_together_are_those_rendered_alone(supersample):
    cameras, grid = ring_of_cameras(3, 24), grid_of(box_scene)
    together = render_images(cameras, [2, 0], field_of(box_scene), grid, EVERY, supersample=supersample)
    alone = [render_images(cameras, [i], field_of(box_scene), grid, EVERY, supersample=supersample) for i in (2, 0)]
    assert not torch.allclose(alone[0].rgb, alone[1].rgb, atol=1e-2)
    for name in ("rgb", "depth", "opacity"):
        assert torch.allclose(getattr(together, name), torch.cat([getattr(one, name) for one in alone]), atol=1e-6)


def test_a_supersampled_pixel_is_the_mean_of_its_rays():
    grid = grid_of(box_scene)
    pixels = render_images(camera(), [0], field_of(box_scene), grid, EVERY, supersample=3)
    fine = render_images(camera().scaled(72, 72), [0], field_of(box_scene), grid, EVERY)
    rgb, opacity = fine.rgb.view(24, 3, 24, 3, 3), fine.opacity.view(24, 3, 24, 3)
    by_hand = sum(rgb[:, row, :, column] for row in range(3) for column in range(3)) / 9
    assert torch.allclose(pixels.rgb, by_hand.reshape(-1, 3), atol=1e-6)
    assert by_hand.std() > 1e-2, "the picture must show something"
    assert torch.allclose(pixels.opacity, opacity.mean(dim=(1, 3)).view(-1), atol=1e-6)
    assert pixels.samples_evaluated == fine.samples_evaluated
    assert torch.equal(pixels.depth_valid, pixels.depth.isfinite())


def test_the_depth_of_a_supersampled_plane_is_that_of_the_pixels_centres():
    def ground(positions):
        return torch.where(positions[:, 2] < 1.0, 5000.0, 0.0)

    grid = grid_of(ground)
    once = render_images(camera(), [0], field_of(ground), grid, EVERY)
    twice = render_images(camera(), [0], field_of(ground), grid, EVERY, supersample=2)
    both = once.median_depth.isfinite() & twice.median_depth.isfinite()
    off = (twice.median_depth - once.median_depth)[both]
    assert both.float().mean() > 0.4
    # samples are 3 to 4 cm apart, rays of one pixel meet the ground up to a metre apart
    assert off.abs().median() < 0.03 and off.mean().abs() < 0.02


@pytest.mark.parametrize(
    ("distances", "middle"),
    [
        ([1.0, 2.0, 3.0, 4.0], 2.4),  # the mean of 1/2 and 1/3 is 5/12
        ([2.0, math.inf, math.inf, math.inf], math.inf),
        ([math.inf, 2.0, 2.0, math.inf], 2.0),  # an edge before the sky
        ([5.0, 1.0, 5.0, 1.0], 1.0),  # an edge before a wall
        ([3.0, 9.0, 1.0], 3.0),
        ([math.inf], math.inf),
    ],
)
def test_the_middle_of_a_pixels_distances(distances, middle):
    assert middle_distance(torch.tensor([distances])).item() == pytest.approx(middle)


def test_depth_is_the_distance_along_the_ray():
    grid = grid_of(box_scene)
    rays = Rays(torch.tensor([[-3.5, 0.0, 0.5]]), unit_directions(torch.tensor([[1.0, 0.1, 0.0]])))
    seen = render(rays, field_of(box_scene), grid, EVERY)
    # the box starts at x = -1: 2.5 m ahead, 2.5 * sqrt(1.01) along the ray; density 20/m adds a mean of 1/20 m
    assert seen.depth.item() == pytest.approx(2.5 * math.sqrt(1.01) + 0.05, abs=0.03)


def test_an_enormous_density_shows_the_first_surface_and_finite_gradients():
    density = torch.tensor(3.27e6, requires_grad=True)
    rays = Rays(torch.tensor([[-9.0, 0.0, 0.5]]), torch.tensor([[1.0, 0.0, 0.0]]))
    seen = render(
        rays,
        lambda x, d, i: (density.expand(len(x)), (x[:, :1] / 8 + 0.5).expand(-1, 3)),
        grid_of(box_scene, updates=1),
        EVERY,
    )
    assert seen.opacity == 1
    seen.rgb.sum().backward()
    assert density.grad.isfinite()
