"""Rays against a box: axis-parallel rays on faces, grazes, far origins, and a million random rays against float64."""

import itertools
import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hashnerf.ray_box import intersect_box
from hashnerf.rays import unit_directions

UNIT = torch.tensor([[-1.0] * 3, [1.0] * 3])
DIAGONAL = 1 / math.sqrt(2)
PLACE = st.sampled_from([-1.0, -0.0, 0.0, 1.0]) | st.floats(-(2.0**100), 2.0**100, width=32)
SLOPE = st.sampled_from([-1.0, -0.0, 0.0, 1e-40, -1e-12]) | st.floats(-1, 1, width=32)


def one(origin, direction, near_min=0.0):
    near, far, hit = intersect_box(torch.tensor([origin]), torch.tensor([direction]), UNIT, near_min)
    return near.item(), far.item(), hit.item()


HITS = (
    ([-3.0, 0.0, 0.0], [1.0, 0.0, 0.0], 2, 4),
    ([-3.0, 1.0, 0.0], [1.0, 0.0, 0.0], 2, 4),  # along a face
    ([-3.0, 1.0, 1.0], [1.0, 0.0, 0.0], 2, 4),  # along an edge
    ([0.0, -3.0, 1.0], [0.0, 1.0, 0.0], 2, 4),
    ([1.0, 1.0, -3.0], [0.0, 0.0, 1.0], 2, 4),
    ([-3.0, 0.0, 0.0], [1.0, -0.0, 0.0], 2, 4),
    ([-3.0, 1.0, 0.0], [1.0, -0.0, 0.0], 2, 4),
    ([0.0, 0.0, 0.0], [0.0, 0.0, 1.0], 0, 1),  # from inside
    ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0], 0, 1),  # from inside, on a face
    ([-3.0, 0.0, 0.0], [1.0, 1e-40, 0.0], 2, 4),  # a denormal component
    ([-3.0, 1.0, 0.0], [1.0, -1e-40, 0.0], 2, 4),
)
MISSES = (
    ([-3.0, 1.5, 0.0], [1.0, 0.0, 0.0]),  # beside
    ([3.0, 0.0, 0.0], [1.0, 0.0, 0.0]),  # behind
    ([-2.0, 0.0, 5.0], [DIAGONAL, DIAGONAL, 0.0]),
)


def test_n45_rays_along_faces_and_axes_hit(numeric_row):
    worst, missed = 0.0, 0
    for origin, direction, near, far in HITS:
        # the same ray with its axes renamed: a rule that treats one axis after another would tell them apart
        for axes in itertools.permutations(range(3)):
            found = one([origin[axis] for axis in axes], [direction[axis] for axis in axes])
            worst = max(worst, abs(found[0] - near), abs(found[1] - far))
            missed += not found[2]
    numeric_row("N45", "distances on faces, edges, from inside, with -0.0 and 1e-40, axes in every order", worst, 1e-6)
    numeric_row("N45", "the same rays: hits that are called a miss", missed)


def test_n45_misses_have_zero_length(numeric_row):
    wrong = 0
    for origin, direction in MISSES:
        near, far, hit = one(origin, direction)
        wrong += hit or near != far
    numeric_row("N45", "rays beside and behind: no hit, no length", wrong)


def test_n45_what_is_not_a_number_misses(numeric_row):
    wrong = 0
    for place, bad in itertools.product(range(6), (math.nan, math.inf, -math.inf)):
        ray = [-3.0, 0.2, 0.1, 1.0, 0.1, -0.1]
        ray[place] = bad
        near, far, hit = one(ray[:3], ray[3:])
        wrong += hit or near != far or not math.isfinite(near)
    numeric_row("N45", "NaN and infinities in origin or direction: no hit, finite distances", wrong)


def test_n45_half_precision_is_upcast(numeric_row):
    origins, directions = torch.rand(1000, 3) * 6 - 3, unit_directions(torch.randn(1000, 3))
    worst = 0.0
    for dtype, one_cast in ((torch.float16, 1e-3), (torch.bfloat16, 8e-3)):
        o, d = origins.to(dtype), directions.to(dtype)
        exact = intersect_box(o.float(), d.float(), UNIT)
        with torch.autocast("cpu", dtype=torch.bfloat16):
            found = intersect_box(o, d, UNIT)
        for ours, theirs in zip(found[:2], exact[:2]):
            worst = max(worst, ((ours.float() - theirs).abs() / (one_cast * theirs + 1e-9)).max().item())
    numeric_row("N45", "float16 and bfloat16 rays: error over that of one cast", worst, 1.0)


@given(st.lists(PLACE, min_size=3, max_size=3), st.lists(SLOPE, min_size=3, max_size=3).filter(any))
def test_every_finite_ray_gets_finite_distances_in_order(origin, direction):
    near, far, hit = one(origin, unit_directions(torch.tensor(direction)).tolist())
    assert math.isfinite(near) and math.isfinite(far)
    assert 0 <= near <= far
    assert hit == (near < far)


def test_n45_a_corner_graze_is_a_hit_of_no_length(numeric_row):
    near, far, hit = one([-2.0, 0.0, 0.0], [DIAGONAL, DIAGONAL, 0.0])
    assert not hit
    worst = max(abs(near - math.sqrt(2)), abs(far - math.sqrt(2)))
    numeric_row("N45", "a graze of an edge: both distances are sqrt(2), no hit", worst, 1e-6)


def test_n45_a_zero_direction_is_refused(numeric_row):
    for zero in (0.0, -0.0):
        with pytest.raises(ValueError, match="zero"):
            one([0.0, 0.0, 0.0], [zero, 0.0, zero])
    numeric_row("N45", "a zero direction: ValueError", 0)


def test_n47_a_near_plane_behind_the_box_leaves_nothing(numeric_row):
    # the box spans 2 to 4 along the ray
    wrong = one([-3.0, 0.0, 0.0], [1.0, 0.0, 0.0], near_min=5.0) != (5.0, 5.0, False)
    wrong += one([-3.0, 0.0, 0.0], [1.0, 0.0, 0.0], near_min=3.0) != (3.0, 4.0, True)
    wrong += one([0.0, 0.0, 0.0], [1.0, 0.0, 0.0]) != (0.0, 1.0, True)  # never behind the origin
    numeric_row("N47", "near plane at 5 before, in and behind a box from 2 to 4", wrong)


def test_n46_far_origins_still_hit(numeric_row):
    worst, missed = 0.0, 0
    for sizes in (1e2, 1e3, 1e4):
        toward = torch.rand(1000, 3) * 1.8 - 0.9
        directions = unit_directions(torch.randn(1000, 3))
        origins = toward - directions * 2 * sizes
        near, far, hit = intersect_box(origins, directions, UNIT)
        slow_near, slow_far = slab_in_float64(origins, directions)
        clear = slow_far - slow_near > 4 * 2**-24 * 2 * sizes  # beyond the rounding of the distances
        missed += int((~hit[clear]).sum())
        error = torch.maximum((near / slow_near - 1).abs(), (far / slow_far - 1).abs())[clear]
        worst = max(worst, error.max().item())
    numeric_row("N46", "origins up to 1e4 box sizes away: hits that are missed", missed)
    numeric_row("N46", "the same: relative error of the distances, which one rounding to float32 makes", worst, 2**-24)


@pytest.mark.parametrize("distance", [1e6, 1e8, 1e30])
def test_n46_absurdly_far_origins_are_finite(distance, numeric_row):
    near, far, hit = one([-distance, 0.5, 0.5], [1.0, 0.0, 0.0])
    wrong = not (math.isfinite(near) and math.isfinite(far) and near <= far)
    wrong += hit and not near < far
    wrong += distance > 2**25 and hit  # beyond it float32 cannot tell the sides of the box apart: a miss, as documented
    numeric_row("N46", f"an origin {distance:.0e} m away: finite and in order", wrong)


def slab_in_float64(origins, directions):
    """Entry and exit by the slab formula, for rays parallel to no face."""
    o, d = origins.double(), directions.double()
    first, second = (-1 - o) / d, (1 - o) / d
    return torch.minimum(first, second).amax(dim=1).clamp(min=0), torch.maximum(first, second).amin(dim=1)


def test_n45_random_rays_against_float64(numeric_row):
    origins = torch.rand(1_000_000, 3) * 6 - 3
    directions = unit_directions(torch.randn(1_000_000, 3))
    near, far, hit = intersect_box(origins, directions, UNIT)
    slow_near, slow_far = slab_in_float64(origins, directions)
    clear = (slow_far - slow_near).abs() > 1e-5
    numeric_row(
        "N45", "1e6 random rays: hits that differ from float64", int((hit != (slow_far > slow_near))[clear].sum())
    )
    both = hit & clear
    worst = torch.maximum((near - slow_near).abs(), (far - slow_far).abs())[both].max()
    numeric_row("N45", "1e6 random rays: error of the distances", worst, 1e-6)
    assert (far >= near).all()


def test_no_rays():
    near, _, hit = intersect_box(torch.zeros(0, 3), torch.zeros(0, 3), UNIT)
    assert near.shape == hit.shape == (0,)
