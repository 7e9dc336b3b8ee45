"""Training rays by state: which pixels count as changed, and that a ray carries its own pixel's colour."""

import torch

from carff.state_rays import build_state_rays, changed_mask
from hashnerf.cameras import Cameras, image_rays


def cameras(count: int, size: int) -> Cameras:
    pose = torch.eye(4).repeat(count, 1, 1)
    pose[:, 0, 3] = torch.arange(count).float()
    flat = torch.full((count, 2), float(size))
    return Cameras(pose, flat, flat / 2, torch.zeros(count, 4), size, size)


def test_changed_pixels_by_hand():
    pictures = torch.zeros(3, 4, 4, 3, dtype=torch.uint8)
    pictures[1, 2, 3, 1] = 13
    pictures[2, 0, 0, 0] = 12  # not more than the threshold
    assert changed_mask(pictures).nonzero().tolist() == [[2, 3]]


def scene():
    # Two states x two cameras; camera 1 has no view of state 1. Every pixel's colour is unique.
    pictures = torch.arange(3 * 4 * 4).reshape(3, 4, 4, 1).expand(-1, -1, -1, 3).to(torch.uint8).contiguous()
    pictures[1] = pictures[0]
    pictures[1, 3, 2] = 255
    return build_state_rays(pictures, cameras(3, 4), torch.tensor([[0, 2], [1, -1]])), pictures


def test_colour_and_ray_belong_together():
    rays_by_state, pictures = scene()
    states = torch.tensor([0, 1]).repeat(50)
    rays, colour = rays_by_state.draw(states, 0.5, torch.Generator().manual_seed(0))
    everything = [image_rays(rays_by_state.cameras, frame) for frame in range(3)]
    for i in range(100):
        frames = [0, 2] if states[i] == 0 else [1]
        candidates = [
            (frame, pixel)
            for frame in frames
            for pixel in range(16)
            if torch.allclose(everything[frame].origins[pixel], rays.origins[i], atol=1e-5)
            and torch.allclose(everything[frame].directions[pixel], rays.directions[i], atol=1e-5)
        ]
        assert len(candidates) == 1
        frame, pixel = candidates[0]
        assert torch.allclose(pictures[frame].reshape(16, 3)[pixel].float() / 255, colour[i])


def test_changed_share_one_draws_changed_pixels_only():
    rays_by_state, _ = scene()
    _, colour = rays_by_state.draw(torch.ones(40, dtype=torch.int64), 1.0, torch.Generator().manual_seed(0))
    assert torch.equal(colour, torch.ones(40, 3))


def test_new_cameras_get_their_share():
    pictures = torch.zeros(4, 4, 4, 3, dtype=torch.uint8)
    views = torch.tensor([[0, 1, 3], [2, -1, 3]])
    known = torch.tensor([[0, -1, 3], [2, -1, 3]])
    rays_by_state = build_state_rays(pictures, cameras(4, 4), views, known)
    assert rays_by_state.new.tolist() == [1]
    states = torch.tensor([0, 1]).repeat(2000)

    def shares(new_share: float) -> list[float]:
        rays, _ = rays_by_state.draw(states, 0.0, torch.Generator().manual_seed(0), new_share)
        return [float((rays.origins[states == state, 0] == 1).float().mean()) for state in (0, 1)]

    assert shares(1.0) == [1.0, 0.0], "state 1 has no view from the new camera"
    assert abs(shares(0.4)[0] - 0.6) < 0.05, "0.4, and a third of the 0.6 that three cameras share alike"
    assert build_state_rays(pictures, cameras(4, 4), views).new.tolist() == []


def test_equal_states_fall_back_to_uniform_pixels():
    pictures = torch.full((2, 4, 4, 3), 7, dtype=torch.uint8)
    rays_by_state = build_state_rays(pictures, cameras(2, 4), torch.tensor([[0], [1]]))
    rays, colour = rays_by_state.draw(torch.zeros(20, dtype=torch.int64), 1.0, torch.Generator().manual_seed(0))
    assert len(rays_by_state.changed) == 0
    assert len(rays) == 20 and torch.allclose(colour, torch.full((20, 3), 7 / 255))
