"""Sample positions: lengths that add up, nothing where it is empty, nothing lost where it is not."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hashnerf.compositing import sample_weights
from hashnerf.errors import UserError
from hashnerf.marching import MarchSettings, intervals, march
from hashnerf.occupancy import OccupancyConfig, OccupancyGrid
from hashnerf.rays import Rays, unit_directions

BOX = torch.tensor([[-5.0, -5.0, 0.0], [5.0, 5.0, 2.0]])
EVERY = MarchSettings(candidates=64, samples=0)


def grid_of(*densities, updates=30):
    """A grid that has learnt a bank of density functions."""
    grid = OccupancyGrid(OccupancyConfig(cell=0.25, warmup=1, turns=1), BOX)
    for _ in range(updates):
        grid.update(lambda positions: torch.stack([density(positions) for density in densities]))
    return grid


def wall(x, density=50.0, thick=0.5):
    """Dense between x and x + thick (m)."""
    return lambda p: torch.where((p[:, 0] >= x) & (p[:, 0] < x + thick), density, 0.0)


def along_x(count=1):
    origins = torch.tensor([[-7.0, 0.1, 1.0]]).repeat(count, 1)
    return Rays(origins, torch.tensor([[1.0, 0.0, 0.0]]).repeat(count, 1))


def everywhere():
    return OccupancyGrid(OccupancyConfig(cell=1.0, warmup=1), BOX)


@given(st.floats(0, 1e4), st.floats(0.01, 1e3), st.integers(1, 300), st.floats(0.01, 1e3))
def test_intervals_tile_the_ray(near, length, count, even):
    settings = MarchSettings(candidates=count, even_distance=even)
    start, dt = intervals(torch.tensor([near]), torch.tensor([near + length]), settings)
    far = torch.tensor([near + length]).item()
    assert (dt > 0).all() or far == near
    assert start[0, 0].item() == pytest.approx(near)
    tolerance = 1e-5 * length + 1e-6 * far
    assert ((start[0, 1:] - (start + dt)[0, :-1]).abs() <= tolerance).all()
    assert (start + dt)[0, -1].item() == pytest.approx(far, abs=tolerance)


def test_spacing_grows_with_distance():
    _, dt = intervals(torch.tensor([0.0]), torch.tensor([300.0]), MarchSettings(candidates=100, even_distance=10.0))
    # edges are even in log(t + 10): each interval is (310/10)^(1/100) times the one before
    assert torch.allclose(dt[0, 1:] / dt[0, :-1], torch.tensor(31 ** (1 / 100)), atol=1e-4)


def test_a_missed_box_gives_no_samples():
    rays = Rays(torch.tensor([[0.0, 0.0, 9.0], [-7.0, 0.0, 1.0]]), torch.tensor([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]))
    for settings in (EVERY, MarchSettings()):
        assert not march(rays, everywhere(), settings).mask.any()


def test_no_rays():
    for settings in (EVERY, MarchSettings()):
        assert march(Rays(torch.zeros(0, 3), torch.zeros(0, 3)), everywhere(), settings).mask.shape[0] == 0


def test_n47_near_beyond_the_box_gives_no_samples(numeric_row):
    # the box spans 2 to 12 along the ray
    wrong = 0
    for samples in (0, 48):
        for near, left in ((20.0, False), (12.0, False), (11.0, True)):
            seen = march(along_x(), everywhere(), MarchSettings(candidates=64, samples=samples, near=near))
            wrong += bool(seen.mask.any()) != left
            wrong += int((seen.dt < 0).sum()) + int((seen.t[seen.mask] < near).sum())
            wrong += not left and bool((seen.dt != 0).any())
    numeric_row("N47", "near planes at 11, 12 and 20 of a box from 2 to 12: samples and lengths", wrong)


def test_every_candidate_is_taken_where_everything_is_occupied():
    samples = march(along_x(), everywhere(), EVERY)
    assert samples.mask.shape == (1, 64)
    assert samples.mask.all()
    assert samples.dt.sum().item() == pytest.approx(10.0, rel=1e-5)
    assert (samples.t.diff() > 0).all()
    assert samples.t.min() > 2
    assert samples.t.max() < 12


def test_jitter_stays_in_its_interval_and_repeats():
    fixed = march(along_x(3), everywhere(), EVERY)
    jittered = march(along_x(3), everywhere(), EVERY, torch.Generator().manual_seed(1))
    again = march(along_x(3), everywhere(), EVERY, torch.Generator().manual_seed(1))
    assert torch.equal(jittered.t, again.t)
    assert ((jittered.t - fixed.t).abs() <= fixed.dt / 2 + 1e-5).all()
    assert (jittered.t[0] != jittered.t[1]).any()


def test_empty_space_is_skipped_and_a_padded_place_is_empty():
    grid = grid_of(wall(2.0))
    both = Rays(torch.cat([along_x().origins, torch.tensor([[-7.0, 0.1, 5.0]])]), along_x(2).directions)
    samples = march(both, grid, EVERY)
    x = -7 + samples.t[0][samples.mask[0]]
    assert len(x) < 10
    assert ((x > 1.7) & (x < 2.8)).all()
    assert not samples.mask[1].any()
    assert (samples.t[1] == 0).all()
    assert (samples.dt[1] == 0).all()


def test_a_ray_ends_behind_what_is_opaque_in_every_condition():
    front, back = wall(-2.0), wall(3.0)
    opaque_in_one = grid_of(lambda p: front(p) + back(p), back)
    opaque_in_both = grid_of(lambda p: front(p) + back(p), front)
    for settings in (EVERY, MarchSettings(candidates=64)):
        seen = march(along_x(), opaque_in_one, settings)
        assert (seen.t[seen.mask] > 9.5).any(), "the wall behind shows in one condition"
        ended = march(along_x(), opaque_in_both, settings)
        assert (ended.t[ended.mask] < 6).all()
        assert ended.mask.any()


@pytest.mark.parametrize("eps", [0.0, 1e-5, 1e-4, 1e-3, 1e-2])
def test_n30_stopping_changes_the_colour_by_at_most_its_bound(eps, numeric_row):
    def fog(positions):
        return 0.8 + 0.2 * torch.sin(3 * positions[:, 0])

    grid = grid_of(fog)
    rays = Rays(
        torch.tensor([[-7.0, 0.0, 1.0]]).repeat(50, 1), unit_directions(torch.randn(50, 3) * 0.1 + torch.eye(3)[0])
    )

    def colour(stop):
        samples = march(rays, grid, MarchSettings(candidates=128, samples=0, stop_transmittance=stop))
        positions = rays.origins[:, None] + rays.directions[:, None] * samples.t[:, :, None]
        density = fog(positions.view(-1, 3)).view(samples.t.shape)
        return sample_weights(density, samples.dt)[0].sum(dim=1)  # white samples before black

    worst = (colour(eps) - colour(0.0)).abs().max()
    numeric_row("N30", f"white fog before black, rays end at a transmittance of {eps}: change of colour", worst, eps)


def test_resampled_integrals_have_no_bias():
    # density varies inside the cells, which the grid does not know: the mean over draws must still be the integral
    def density(positions):
        return 0.3 * (1 + torch.sin(8 * positions[:, 0])) * (positions[:, 0] > -1)

    grid = grid_of(density, lambda p: density(p) * 0.1)
    rays = along_x(4000)
    samples = march(rays, grid, MarchSettings(candidates=64, samples=12), torch.Generator().manual_seed(0))
    positions = rays.origins[:, None] + rays.directions[:, None] * samples.t[:, :, None]
    thickness = (density(positions.view(-1, 3)).view(samples.t.shape) * samples.dt).sum(dim=1)
    x = torch.linspace(-5, 5, 100_001)
    exact = torch.trapezoid(density(torch.stack([x, x, x], dim=1)), x)
    error = thickness.std() / math.sqrt(len(thickness))
    assert (thickness.mean() - exact).abs() < 4 * error
    assert thickness.std() < 0.5 * exact, "samples must follow the expected opacity"


def test_resampling_puts_samples_where_opacity_is_expected():
    grid = grid_of(wall(2.0), lambda p: torch.zeros(len(p)))
    samples = march(along_x(), grid, MarchSettings(candidates=64, samples=32))
    assert 4 <= samples.mask.sum() <= 32
    x = -7 + samples.t[samples.mask]
    assert ((x > 1.7) & (x < 2.8)).all()
    assert (x.diff() >= 0).all()
    # uniform expectation over the occupied stretch of about half a metre: lengths add up to it
    assert samples.dt.sum().item() == pytest.approx(0.6, abs=0.25)


def test_samples_are_spent_on_what_may_be_seen():
    # thin walls, so that no cell is opaque throughout and no ray ends early
    front, back = wall(-2.1, thick=0.2), wall(3.0)
    hidden = grid_of(lambda p: front(p) + back(p), front)
    open_in_one = grid_of(lambda p: front(p) + back(p), back)
    settings = MarchSettings(candidates=64, samples=40, samples_per_opacity=8.0)

    def share_behind(grid):
        samples = march(along_x(200), grid, settings, torch.Generator().manual_seed(0))
        return (samples.t[samples.mask] > 9.5).float().mean()

    assert share_behind(hidden) < 0.5 * share_behind(open_in_one)
    assert share_behind(hidden) > 0, "a guess: what is behind keeps a few samples"


@pytest.mark.parametrize(("guided", "usually_off"), [(0.0, 0.04), (6.0, 0.02)])
def test_rays_that_skim_the_ground_meet_it(guided, usually_off):
    # the ground reaches a little into a layer of cells: a flat ray passes over many of those before it comes down
    def ground(positions):
        return torch.where(positions[:, 2] < 0.51, 200.0, 0.0)

    falls = torch.linspace(0.035, 0.2, 300)
    directions = unit_directions(torch.stack([torch.ones(300), torch.zeros(300), -falls], dim=1))
    rays = Rays(torch.tensor([[-4.9, 0.1, 0.74]]).repeat(300, 1), directions)
    settings = MarchSettings(candidates=64, guided_per_opacity=guided)
    samples = march(rays, grid_of(ground), settings, None, lambda positions, ray: ground(positions), look_at_ends=True)
    positions = rays.origins[:, None] + directions[:, None] * samples.t[:, :, None]
    weights, _ = sample_weights(ground(positions.view(-1, 3)).view(samples.t.shape), samples.dt)
    assert weights.sum(dim=1).min() > 0.9
    met = (weights * samples.t).sum(dim=1) / weights.sum(dim=1)
    off = (met / (0.23 / -directions[:, 2]) - 1).abs()
    assert off.median() < usually_off
    assert off.max() < 0.1


def test_samples_per_ray_are_capped():
    samples = march(along_x(5), everywhere(), MarchSettings(candidates=64, samples=7, samples_per_opacity=100.0))
    assert samples.mask.shape[1] <= 7


def test_n46_far_origins_are_finite(numeric_row):
    rays = Rays(torch.tensor([[-1e4, 0.1, 1.0], [-1e8, 0.1, 1.0]]), along_x(2).directions)
    wrong = 0
    for settings in (EVERY, MarchSettings()):
        samples = march(rays, everywhere(), settings, torch.Generator())
        wrong += int((~samples.t.isfinite()).sum()) + int((~(samples.dt >= 0)).sum())
        wrong += not samples.mask[0].any()
    numeric_row("N46", "samples of rays from 1e4 and 1e8 m away", wrong)


GUIDED = MarchSettings(candidates=64, samples=48, samples_per_opacity=8.0, guided_per_opacity=6.0)


def on_rays(density):
    """A density of positions as marching asks for it."""
    return lambda positions, ray: density(positions)


def test_guided_samples_place_a_surface_better_than_as_many_others():
    # opaque within a centimetre, in an occupied stretch of a quarter of a metre
    board = wall(2.1, density=300.0, thick=0.1)
    grid = grid_of(wall(2.0, density=20.0, thick=0.25))
    rays = along_x(2000)

    def found(settings, density_fn):
        samples = march(rays, grid, settings, torch.Generator().manual_seed(0), density_fn)
        positions = rays.origins[:, None] + rays.directions[:, None] * samples.t[:, :, None]
        density = board(positions.view(-1, 3)).view(samples.t.shape) * samples.mask
        weights, _ = sample_weights(density, samples.dt)
        hit = (weights * samples.t).sum(dim=1) / weights.sum(dim=1).clamp(min=1e-9) - 7
        return (hit - 2.1).abs().median(), weights.sum(dim=1).mean(), samples.mask.sum(dim=1).float().mean()

    off_once, seen_once, count_once = found(replace(GUIDED, samples_per_opacity=8.0), None)
    off_twice, seen_twice, count_twice = found(GUIDED, on_rays(board))
    assert count_twice <= count_once
    assert off_twice < 0.6 * off_once
    assert min(seen_once, seen_twice) > 0.98


def test_guided_samples_follow_the_density_and_leave_nothing_out():
    front, back = wall(-2.0, density=30.0), wall(3.0, density=30.0)
    grid = grid_of(lambda p: front(p) + back(p), lambda p: torch.zeros(len(p)))
    everything = march(
        along_x(500), grid, GUIDED, torch.Generator().manual_seed(0), on_rays(lambda p: front(p) + back(p))
    )
    x = -7 + everything.t[everything.mask]
    assert ((x > -2.3) & (x < -1.2)).float().mean() > 0.6, "what stops the light"
    assert (x > 2.7).float().mean() > 0.02, "what is hidden keeps a few"
    assert (everything.t.diff(dim=1)[everything.mask[:, 1:]] >= 0).all()


def test_where_the_guide_finds_nothing_samples_are_spread_evenly():
    empty = march(along_x(), everywhere(), GUIDED, None, on_rays(lambda p: torch.zeros(len(p))))
    assert empty.mask.sum() == 4  # a floor of half an opaque interval: 0.5 * 6 + 1
    assert torch.allclose(empty.dt[empty.mask], torch.full((4,), 2.5), atol=1e-4)
    assert torch.allclose(empty.t[0], torch.tensor([3.25, 5.75, 8.25, 10.75]), atol=1e-3)


@pytest.mark.parametrize("broken", [math.nan, math.inf])
def test_a_broken_guide_spoils_no_place(broken):
    def density(positions):
        return torch.where(positions[:, 0] > 0, broken, wall(-2.0)(positions))

    samples = march(along_x(50), everywhere(), GUIDED, torch.Generator().manual_seed(0), on_rays(density))
    assert samples.t.isfinite().all() and samples.dt.isfinite().all()
    assert samples.mask.any(dim=1).all()


def test_no_guide_can_be_asked_where_every_interval_is_taken():
    with pytest.raises(UserError, match="guided_per_opacity needs"):
        MarchSettings(samples=0, guided_per_opacity=4.0)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("candidates", -1),
        ("samples", -1),
        ("samples_per_opacity", 0.0),
        ("samples_per_opacity", 1e300),
        ("guided_per_opacity", -1.0),
        ("guided_per_opacity", math.inf),
        ("even_distance", -1.0),
        ("near", -1.0),
        ("near", 1e39),
        ("even_distance", 1e39),
        ("candidates", 10**20),
        ("samples", 10**20),
        ("stop_transmittance", 1.0),
    ],
)
def test_impossible_settings_name_the_key(key, value):
    with pytest.raises(UserError, match=f"march.{key} is"):
        MarchSettings(**{key: value})
