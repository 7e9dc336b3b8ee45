"""Input jitter: range, determinism, identity at strength zero."""

import torch

from carff.augmentation import jitter_pictures


def test_values_stay_in_range_and_repeat_with_the_seed():
    pictures = torch.rand(4, 3, 16, 16, generator=torch.Generator().manual_seed(1))
    once = jitter_pictures(pictures, 1.0, torch.Generator().manual_seed(3))
    again = jitter_pictures(pictures, 1.0, torch.Generator().manual_seed(3))
    other = jitter_pictures(pictures, 1.0, torch.Generator().manual_seed(4))
    assert once.min() >= 0 and once.max() <= 1
    assert torch.equal(once, again)
    assert not torch.equal(once, other)


def test_strength_zero_changes_nothing():
    pictures = torch.rand(2, 3, 16, 16, generator=torch.Generator().manual_seed(1))
    assert torch.allclose(jitter_pictures(pictures, 0.0, torch.Generator()), pictures, atol=1e-5)


def test_pictures_are_shifted_each_on_its_own():
    pictures = torch.zeros(8, 3, 32, 32)
    pictures[:, :, :, 16:] = 1.0
    moved = jitter_pictures(pictures, 1.0, torch.Generator().manual_seed(0))
    edges = (moved[:, 0].mean(dim=1).diff(dim=1)).argmax(dim=1)
    assert len(set(edges.tolist())) > 1


def test_a_shift_moves_whole_pixels_and_stays_within_its_range():
    pictures = torch.zeros(64, 3, 50, 50)
    pictures[:, :, 25, 25] = 1.0
    moved = jitter_pictures(pictures, 1.0, torch.Generator().manual_seed(0))
    spots = [(picture[0] > picture[0].median() + 0.5).nonzero() for picture in moved]
    assert all(len(spot) == 1 for spot in spots), "one bright pixel stays one bright pixel"
    offset = torch.cat(spots) - 25
    assert offset.abs().max() == 3, "6 % of 50 pixels"
    assert len(offset.unique(dim=0)) > 20
