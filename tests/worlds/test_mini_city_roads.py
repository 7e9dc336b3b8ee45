"""The mini-city's roads: where asphalt is, what is painted on it, and lines that a car can follow."""

import numpy as np
import pytest

from worlds.mini_city_roads import (
    CENTRE_LINES,
    CROSS,
    LANE,
    LOOP,
    WIDTH,
    X0,
    Y0,
    Y1,
    band,
    on_road,
    road_bodies,
    road_network,
    trajectories,
)
from worlds.polylines import arc_lengths, beside, distance_to, resampled
from worlds.raycast import Caster
from worlds.street import ASPHALT

SMALLEST_TURN = 0.33 / np.tan(0.4189)  # metres: wheelbase and steering limit of the F1TENTH car
HALF_CAR = 0.15


def seen_from_above(points: np.ndarray) -> list[str]:
    bodies = road_bodies()
    caster = Caster([(number, mesh) for number, (_, mesh) in enumerate(bodies, 1)])
    origins = np.column_stack([points, np.ones(len(points))]).astype(np.float32)
    _, face = caster.cast(origins, np.tile(np.float32([0, 0, -1]), (len(points), 1)))
    return [bodies[caster.object_id[one] - 1][0] if one >= 0 else "" for one in face]


def test_asphalt_by_hand():
    reach = LANE + 0.1
    points = [(X0, 2.5), (X0 + LANE - 0.01, 2.5), (X0 + LANE + 0.01, 2.5), (CROSS, 2.0), (1.9, 2.0), (0.0, 0.0)]
    points += [(CROSS + reach, Y0 + reach), (CROSS - reach, Y1 - reach), (CROSS + 0.9, Y0 + 0.9)]
    expected = [True, True, False, True, False, False, True, True, False]
    assert on_road(np.array(points)).tolist() == expected
    assert on_road(np.array([(X0 + LANE + 0.04, 2.5)]), margin=0.05).all()


def test_what_is_seen_from_above_is_asphalt_exactly_where_it_should_be():
    points = np.random.default_rng(0).uniform((0.2, 0.2), (5.8, 4.8), (4000, 2))
    sure = on_road(points, -0.02) == on_road(points, 0.02)
    found = [name in ("road", "markings") for name in np.array(seen_from_above(points))[sure]]
    assert (np.array(found) == on_road(points)[sure]).mean() > 0.999


def test_the_loop_has_a_dashed_middle_line():
    middle = resampled(LOOP, 0.05)
    straight = middle[(middle[:, 0] < X0 + 0.01)]
    names = seen_from_above(straight)
    assert 0.3 < names.count("markings") / len(names) < 0.7


@pytest.mark.parametrize("name", ["outer_loop", "left_turns", "right_turns"])
def test_a_car_can_follow_every_trajectory_on_its_lane(name):
    line = trajectories()[name]
    assert np.array_equal(line[0], line[-1])
    for side in (-HALF_CAR, HALF_CAR):
        assert on_road(beside(line, side), margin=0.01).all()
    fine = resampled(line, 0.05)
    a, b, c = fine[:-2], fine[1:-1], fine[2:]
    sides = [np.linalg.norm(p - q, axis=1) for p, q in ((a, b), (b, c), (a, c))]
    area = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    radius = np.prod(sides, axis=0) / np.maximum(4 * area, 1e-9)
    assert radius.min() > SMALLEST_TURN
    off_junction = (np.abs(fine[:, 0] - CROSS) > 1.0) | (np.abs(fine[:, 1] - 2.5) < 0.5)
    assert min(distance_to(one, fine[off_junction]).max() for one in CENTRE_LINES) > 0
    nearest = np.min([distance_to(one, fine[off_junction]) for one in CENTRE_LINES], axis=0)
    assert nearest == pytest.approx(LANE / 2, abs=0.02), "the middle of a lane"


def test_trajectories_keep_to_the_right():
    for line in trajectories().values():
        fine = resampled(line, 0.05)
        right = beside(fine, -LANE)
        left = beside(fine, LANE)
        on_left = on_road(left, -0.1)
        assert on_left.mean() > 0.9 and on_road(right, -0.1).mean() < 0.35


def test_the_network_is_told_in_metres_and_bytes():
    network = road_network()
    assert network["width"] == WIDTH and network["height"] == 0.0 and len(network["lines"]) == 2
    assert all(0 < channel < 255 for channel in network["colour"])
    assert max(network["colour"]) - min(network["colour"]) < 20, "asphalt is grey"
    assert arc_lengths(np.array(network["lines"][1]))[-1] == pytest.approx(Y1 - Y0)


def test_a_band_faces_up_and_has_the_width_asked_for():
    mesh = band(np.array([(0.0, 0.0), (2.0, 0.0)]), -0.5, 0.25, 0.3, ASPHALT)
    assert Caster([(1, mesh)]).normal[:, 2] == pytest.approx(1.0)
    assert mesh.bounds == pytest.approx(np.array([[0, -0.5, 0.3], [2, 0.25, 0.3]]))
