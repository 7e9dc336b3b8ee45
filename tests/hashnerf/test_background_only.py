"""A sky explains pictures of a sky, and not of things that stand somewhere."""

import torch

from hashnerf.background_only import HOPELESS_DB, background_alone
from hashnerf.cameras import image_rays
from hashnerf.capacity import EMPTY_BLOCK_DB, EMPTY_DB
from tests.hashnerf.analytic_scene import BOX, ring_of_cameras
from tests.hashnerf.posed_scene import posed_scene


def sky_pictures(count: int = 6, size: int = 24):
    """What `count` cameras see of a sky with a horizon: bright below, darker with height above."""
    cameras = ring_of_cameras(count, size)
    up = torch.stack([image_rays(cameras, index).directions[:, 2].view(size, size, 1) for index in range(count)])
    colour = torch.where(up > 0, 0.8 - 0.6 * up, torch.tensor(0.8)) * torch.tensor([1.0, 0.9, 0.7])
    return (colour * 255).round().to(torch.uint8), cameras


def test_a_sky_with_a_horizon_is_explained_by_direction():
    pictures, cameras = sky_pictures()
    found = background_alone(pictures, cameras, BOX, 3, 64)
    assert found.mean_db > EMPTY_DB and found.worst_block_db > EMPTY_BLOCK_DB
    # without a hidden layer the horizon is as soft as the harmonics are
    assert background_alone(pictures, cameras, BOX, 3, 0).mean_db < found.mean_db


def test_a_small_thing_before_the_sky_is_not():
    pictures, cameras = sky_pictures(size=128)
    pictures[2, 70:72, 30:32] = 10  # four pixels of 16,384 hardly move the mean
    found = background_alone(pictures, cameras, BOX, 3, 64)
    assert found.mean_db > EMPTY_DB and found.worst_block_db < EMPTY_BLOCK_DB


def test_a_ball_on_a_floor_is_not():
    data = posed_scene()
    assert background_alone(data.images, data.cameras, BOX, 3, 64).mean_db < HOPELESS_DB


def test_it_repeats_and_leaves_the_random_numbers_alone():
    pictures, cameras = sky_pictures(count=2, size=8)
    torch.manual_seed(5)
    before = torch.get_rng_state()
    first = background_alone(pictures, cameras, BOX, 2, 8)
    assert torch.equal(before, torch.get_rng_state())
    torch.manual_seed(6)
    assert background_alone(pictures, cameras, BOX, 2, 8) == first
