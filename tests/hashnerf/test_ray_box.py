"""Rays against a box: axis-parallel rays on faces, grazes, far origins, and a million random rays against float64."""

import math

import pytest
import torch

from hashnerf.ray_box import intersect_box
from hashnerf.rays import unit_directions

UNIT = torch.tensor([[-1.0] * 3, [1.0] * 3])
DIAGONAL = 1 / math.sqrt(2)


def one(origin, direction, near_min=0.0):
    near, far, hit = intersect_box(torch.tensor([origin]), torch.tensor([direction]), UNIT, near_min)
    return near.item(), far.item(), hit.item()


@pytest.mark.parametrize(
    ("origin", "direction", "near", "far"),
    [
        ([-3.0, 0.0, 0.0], [1.0, 0.0, 0.0], 2, 4),
        ([-3.0, 1.0, 0.0], [1.0, 0.0, 0.0], 2, 4),  # along a face
        ([-3.0, 1.0, 1.0], [1.0, 0.0, 0.0], 2, 4),  # along an edge
        ([0.0, -3.0, 1.0], [0.0, 1.0, 0.0], 2, 4),
        ([1.0, 1.0, -3.0], [0.0, 0.0, 1.0], 2, 4),
        ([-3.0, 0.0, 0.0], [1.0, -0.0, 0.0], 2, 4),
        ([0.0, 0.0, 0.0], [0.0, 0.0, 1.0], 0, 1),  # from inside
        ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0], 0, 1),  # from inside, on a face
        ([-3.0, 0.0, 0.0], [1.0, 1e-40, 0.0], 2, 4),  # a denormal component
        ([-3.0, 1.0, 0.0], [1.0, -1e-40, 0.0], 2, 4),
    ],
)
def test_hits(origin, direction, near, far):
    assert one(origin, direction) == (pytest.approx(near, abs=1e-6), pytest.approx(far, abs=1e-6), True)


@pytest.mark.parametrize(
    ("origin", "direction"),
    [
        ([-3.0, 1.5, 0.0], [1.0, 0.0, 0.0]),  # beside
        ([3.0, 0.0, 0.0], [1.0, 0.0, 0.0]),  # behind
        ([-2.0, 0.0, 5.0], [DIAGONAL, DIAGONAL, 0.0]),
    ],
)
def test_misses_have_zero_length(origin, direction):
    near, far, hit = one(origin, direction)
    assert not hit
    assert near == far


def test_a_corner_graze_is_a_hit_of_no_length():
    near, far, hit = one([-2.0, 0.0, 0.0], [DIAGONAL, DIAGONAL, 0.0])
    assert not hit
    assert near == pytest.approx(math.sqrt(2), abs=1e-6)
    assert far == pytest.approx(math.sqrt(2), abs=1e-6)


def test_near_plane_behind_the_box_leaves_nothing():
    # the box spans 2 to 4 along the ray; the near plane is at 5
    assert one([-3.0, 0.0, 0.0], [1.0, 0.0, 0.0], near_min=5.0) == (5.0, 5.0, False)
    assert one([-3.0, 0.0, 0.0], [1.0, 0.0, 0.0], near_min=3.0) == (3.0, 4.0, True)


def test_a_zero_direction_is_refused():
    with pytest.raises(ValueError, match="zero"):
        one([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])


@pytest.mark.parametrize("distance", [1e4, 2e4])
def test_far_origins_still_hit(distance):
    near, far, hit = one([-distance, 0.5, 0.5], [1.0, 0.0, 0.0])
    assert hit
    assert near == pytest.approx(distance - 1)
    assert far == pytest.approx(distance + 1)


@pytest.mark.parametrize("distance", [1e6, 1e8, 1e30])
def test_absurdly_far_origins_are_finite(distance):
    near, far, _ = one([-distance, 0.5, 0.5], [1.0, 0.0, 0.0])
    assert near <= far
    assert math.isfinite(near)


def test_random_rays_against_float64():
    origins = torch.rand(1_000_000, 3) * 6 - 3
    directions = unit_directions(torch.randn(1_000_000, 3))
    near, far, hit = intersect_box(origins, directions, UNIT)
    o, d = origins.double().numpy(), directions.double().numpy()
    slow_near, slow_far = 0.0, float("inf")
    for axis in range(3):
        first, second = (-1 - o[:, axis]) / d[:, axis], (1 - o[:, axis]) / d[:, axis]
        slow_near = torch.from_numpy(first.clip(max=second)).clamp(min=0).maximum(torch.as_tensor(slow_near))
        slow_far = torch.from_numpy(second.clip(min=first)).minimum(torch.as_tensor(slow_far))
    clear = (slow_far - slow_near).abs() > 1e-5
    assert torch.equal(hit[clear], (slow_far > slow_near)[clear])
    both = hit & clear
    assert (near[both] - slow_near[both]).abs().max() < 1e-6
    assert (far[both] - slow_far[both]).abs().max() < 1e-6
    assert (far >= near).all()


def test_no_rays():
    near, _, hit = intersect_box(torch.zeros(0, 3), torch.zeros(0, 3), UNIT)
    assert near.shape == hit.shape == (0,)
