"""What lies beyond the box: places on the ground worked by hand, the horizon, learning it, and the extremes."""

import math

import pytest
import torch

from hashnerf.background import Background
from hashnerf.rays import Rays, unit_directions

BOX = torch.tensor([[-4.0, -2.0, 0.0], [4.0, 2.0, 2.0]])


def background(ground=True):
    return Background(BOX, direction_degree=3, condition_size=0, ground=ground)


def rays(origin, *directions):
    directions = unit_directions(torch.tensor(directions))
    return Rays(torch.tensor(origin).expand_as(directions), directions)


def test_places_worked_by_hand():
    # from 1 m above the middle: the ground at x = 2 is half of the box, at y = 2 its edge, at x = 10 2.5 times the box
    seen = rays((0.0, 0.0, 1.0), (2.0, 0.0, -1.0), (0.0, 2.0, -1.0), (10.0, 0.0, -1.0), (0.0, -1.0, 0.0))
    expected = torch.tensor([(0.25, 0.0), (0.0, 0.5), ((2 - 1 / 2.5) / 2, 0.0), (0.0, -1.0)])
    assert torch.allclose(background().places(seen), expected, atol=1e-3)


def test_a_place_is_the_same_from_everywhere():
    origins = torch.tensor([[0.0, 0.0, 1.0], [-3.0, 1.0, 2.0], [5.0, 0.0, 0.5]])
    towards = unit_directions(torch.tensor([7.0, -5.0, 0.0]) - origins)
    places = background().places(Rays(origins, towards))
    assert torch.allclose(places, places[:1].expand_as(places), atol=1e-5)


def test_the_horizon_is_sharp_and_the_sky_knows_no_place():
    model = background()
    torch.nn.init.constant_(model.picture, 3.0)
    above, below = model(rays((0.0, 0.0, 1.0), (1.0, 0.0, 1e-3), (1.0, 0.0, -1e-3)), [])
    assert (above - below).abs().min() > 0.2
    first, second = (model(rays(origin, (1.0, 0.0, 0.1)), []) for origin in ((0.0, 0.0, 1.0), (2.0, 1.0, 0.3)))
    assert torch.equal(first, second)


def test_a_sky_that_no_picture_showed_is_grey():
    sky = background()(rays((0.0, 0.0, 1.0), (1.0, 0.0, 0.1), (0.3, -1.0, 2.0)), [])
    assert torch.equal(sky, torch.full((2, 3), 0.5))


def test_under_the_box_nothing_is_painted():
    model = background()
    seen = rays((0.0, 0.0, 1.0), (2.0, 0.0, -1.0), (0.0, 1.9, -1.0), (4.5, 0.0, -1.0))
    before = model(seen, [])
    torch.nn.init.constant_(model.picture, 3.0)
    assert torch.equal(model(seen, [])[:2], before[:2]) and not torch.allclose(model(seen, [])[2], before[2])


def test_without_ground_only_the_direction_counts():
    model = background(ground=False)
    first, second = (model(rays(origin, (1.0, 0.0, -0.3)), []) for origin in ((0.0, 0.0, 1.0), (2.0, 1.0, 0.3)))
    assert torch.equal(first, second)


def looking_down(count, generator):
    origins = torch.rand(count, 3, generator=generator) * torch.tensor([6.0, 3.0, 1.0]) + torch.tensor([-3, -1.5, 0.5])
    azimuth = torch.rand(count, generator=generator) * 2 * math.pi
    directions = torch.stack([azimuth.cos(), azimuth.sin(), torch.full((count,), -0.15)], dim=1)
    return Rays(origins, unit_directions(directions))


def learned_error(model):
    """Mean absolute error after learning a ground that is dark, with a bright strip beyond x = 6 m."""
    generator = torch.Generator().manual_seed(0)
    optimizer = torch.optim.Adam(model.parameters(), lr=0.05)
    error = torch.zeros(())
    for _ in range(150):
        seen = looking_down(2000, generator)
        reach = seen.origins[:, 2] / -seen.directions[:, 2]
        x = seen.origins[:, 0] + seen.directions[:, 0] * reach
        error = (model(seen, []) - torch.where(x > 6.0, 0.8, 0.2)[:, None]).abs().mean()
        optimizer.zero_grad()
        error.backward()
        optimizer.step()
    return float(error.detach())


def test_ground_beyond_the_box_is_learned_by_place_and_cannot_be_by_direction():
    assert learned_error(background()) < 0.02
    assert learned_error(background(ground=False)) > 0.05


@pytest.mark.parametrize("origin", [(0.0, 0.0, 1e-9), (1e6, -1e6, 1e6), (0.0, 0.0, -5.0), (0.0, 0.0, 1e20)])
def test_extreme_rays_have_colours_and_finite_gradients(origin):
    model = background()
    torch.nn.init.normal_(model.picture)
    directions = unit_directions(
        torch.tensor([(1.0, 0.0, 0.0), (1.0, 0.0, -1e-30), (0.0, 0.0, -1.0), (0.0, 0.0, 1.0), (1.0, 1.0, -1e-4)])
    )
    start = torch.tensor(origin).expand_as(directions).clone().requires_grad_()
    directions.requires_grad_()
    colour = model(Rays(start, directions), [])
    assert ((colour >= 0) & (colour <= 1)).all()
    colour.sum().backward()
    for gradient in (start.grad, directions.grad, *(parameter.grad for parameter in model.parameters())):
        assert gradient.isfinite().all()


def test_a_sky_with_a_hidden_layer_is_grey_at_first_and_learns_a_sharp_horizon():
    torch.manual_seed(0)
    model = Background(BOX, direction_degree=3, condition_size=0, ground=False, sky_width=32)
    directions = unit_directions(torch.randn(2000, 3))
    seen = Rays(torch.zeros(2000, 3), directions)
    assert torch.equal(model(seen, []), torch.full((2000, 3), 0.5))
    up = directions[:, 2:]
    colour = torch.where(up > 0, 0.3 + 0.6 * up, torch.tensor(0.3)).expand(-1, 3)

    def error(sky) -> float:
        optimizer = torch.optim.Adam(sky.parameters(), lr=0.03)
        for _ in range(300):
            optimizer.zero_grad()
            loss = (sky(seen, []) - colour).square().mean()
            loss.backward()
            optimizer.step()
        return float(loss)

    assert error(model) < 0.5 * error(background(ground=False))
