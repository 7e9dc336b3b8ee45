"""Rays drawn from pictures are those of their cameras."""

from dataclasses import replace

import torch

from hashnerf.cameras import camera_rays
from hashnerf.picture_rays import PictureRays, local_directions
from tests.hashnerf.posed_scene import posed_scene


def test_rays_equal_those_of_the_cameras():
    data = posed_scene()
    pictures = PictureRays.of(data)
    number, pixel = pictures.draw(500, torch.Generator().manual_seed(0))
    rays, colour = pictures.rays(number, pixel)
    row, column = pixel // data.cameras.width, pixel % data.cameras.width
    expected = camera_rays(data.cameras, number, torch.stack([column, row], dim=1) + 0.5)
    assert torch.allclose(rays.directions, expected.directions, atol=1e-5)
    assert torch.equal(rays.origins, expected.origins)
    assert torch.equal(colour, data.images[number, row, column].float() / 255)


def test_lenses_may_differ():
    data = posed_scene()
    focal = data.cameras.focal * torch.linspace(1, 1.2, len(data))[:, None]
    data = replace(data, cameras=replace(data.cameras, focal=focal))
    pictures = PictureRays.of(data)
    assert len(pictures.local) == len(data) and not torch.allclose(pictures.local[0], pictures.local[-1])
    assert torch.allclose(pictures.local[3], local_directions(data.cameras, 3))


def test_every_picture_and_pixel_is_drawn_alike():
    data = posed_scene(count=4, size=4)
    number, pixel = PictureRays.of(data).draw(64_000, torch.Generator().manual_seed(1))
    counts = torch.bincount(number * 16 + pixel, minlength=64)
    # 1000 each; the standard deviation of a binomial count is sqrt(1000 * 63 / 64), 31
    assert len(counts) == 64 and int((counts - 1000).abs().max()) < 5 * 31


def test_corrections_move_the_rays():
    pictures = PictureRays.of(posed_scene())
    number, pixel = torch.tensor([0, 3]), torch.tensor([7, 100])

    def up(poses, which):
        assert torch.equal(which, number)
        return poses + torch.tensor([[0.0] * 4, [0.0] * 4, [0.0, 0.0, 0.0, 1.0], [0.0] * 4])

    still, moved = (pictures.rays(number, pixel, correct)[0] for correct in (None, up))
    assert torch.allclose(moved.origins - still.origins, torch.tensor([0.0, 0.0, 1.0]))
    assert torch.equal(moved.directions, still.directions)
