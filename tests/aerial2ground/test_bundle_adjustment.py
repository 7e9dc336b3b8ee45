"""Bundle adjustment: exact data give the exact poses, mistakes do not matter, derivatives are those of the errors."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerial2ground.bundle_adjustment import (
    Beliefs,
    Bundle,
    Sightings,
    _cost,
    _slopes,
    _System,
    adjusted,
    errors,
    triangulated,
)

BELIEFS = Beliefs(0.05, 0.05, 0.001)


def town(rng: np.random.Generator, cameras: int = 8, points: int = 60) -> tuple[Bundle, Sightings]:
    """Cameras 2 m above a bumpy square that look down, tilted by up to half a radian; all see all points."""
    positions = np.column_stack([rng.uniform(-1, 1, (cameras, 2)), rng.uniform(1.8, 2.4, cameras)])
    rotations = Rotation.from_rotvec(rng.uniform(-0.25, 0.25, (cameras, 3))).as_matrix()
    places = np.column_stack([rng.uniform(-1, 1, (points, 2)), rng.uniform(0, 0.3, points)])
    truth = Bundle(rotations, positions, places)
    camera, point = np.tile(np.arange(cameras), points), np.repeat(np.arange(points), cameras)
    seen = Sightings(camera, point, np.zeros((len(camera), 2)))
    return truth, Sightings(camera, point, errors(truth, seen)[0])


def told(truth: Bundle, rng: np.random.Generator, metres: float = 0.05, radians: float = 0.05) -> Bundle:
    noise = rng.standard_normal((len(truth.position), 6)) * np.repeat([metres, radians], 3)
    return truth.moved(noise, np.zeros_like(truth.points))


def misfit(bundle: Bundle, seen: Sightings) -> float:
    return float(np.linalg.norm(errors(bundle, seen)[0], axis=1).max())


def relative(bundle: Bundle) -> np.ndarray:
    """Rotations and baselines in the first camera's frame: what does not depend on the gauge but the scale."""
    first = bundle.rotation[0].T
    base = (bundle.position - bundle.position[0]) @ bundle.rotation[0]
    return np.concatenate([(first @ bundle.rotation).reshape(-1, 9), base / np.linalg.norm(base)], axis=1)


def solve(start: Bundle, seen: Sightings, scale: float = 50.0) -> Bundle:
    first = Bundle(start.rotation, start.position, triangulated(start.rotation, start.position, seen))
    return adjusted(start, first, seen, BELIEFS, scale, most_steps=60)


def test_exact_sightings_give_exact_relative_poses():
    rng = np.random.default_rng(0)
    truth, seen = town(rng)
    start = told(truth, rng)
    found = solve(start, seen)
    assert np.abs(relative(start) - relative(truth)).max() > 0.03
    # what is told pulls a little at a scene that could be a trifle larger or smaller
    assert misfit(found, seen) < 1e-4 and np.abs(relative(found) - relative(truth)).max() < 1e-3


def test_the_gauge_is_that_of_what_was_told():
    rng = np.random.default_rng(1)
    truth, seen = town(rng, cameras=24)
    start = told(truth, rng)
    found = solve(start, seen)
    assert np.linalg.norm((found.position - truth.position).mean(axis=0)) < 0.04
    assert np.linalg.norm(found.from_told(start).mean(axis=0)[:3]) < 0.02


def test_a_tenth_of_wrong_sightings_changes_little():
    rng = np.random.default_rng(2)
    truth, seen = town(rng)
    start = told(truth, rng, 0.01, 0.01)
    place = seen.place.copy()
    wrong = rng.random(len(place)) < 0.1
    place[wrong] += rng.uniform(-0.3, 0.3, (int(wrong.sum()), 2))
    spoilt = Sightings(seen.camera, seen.point, place)
    robust, trusting = (solve(solve(start, spoilt, 100.0), spoilt, scale) for scale in (2.0, 1e6))
    off = [np.abs(relative(one) - relative(truth)).max() for one in (robust, trusting)]
    assert off[0] < 0.002 < 0.01 < off[1]


def test_a_camera_that_sees_nothing_stays_where_it_was_told():
    rng = np.random.default_rng(3)
    truth, seen = town(rng)
    start = told(truth, rng)
    kept = seen.camera != 3
    found = solve(start, Sightings(seen.camera[kept], seen.point[kept], seen.place[kept]))
    assert np.abs(found.from_told(start)[3]).max() < 1e-9
    assert np.abs(found.from_told(start)[2]).max() > 1e-3


def test_slopes_are_those_of_the_errors():
    rng = np.random.default_rng(4)
    truth, seen = town(rng, cameras=3, points=4)
    _, local = errors(truth, seen)
    by_camera, by_point = _slopes(local, truth.rotation[seen.camera], np.ones(len(local), bool))
    still, step = np.zeros((3, 6)), 1e-6
    for column in range(6):
        nudge = still.copy()
        nudge[:, column] = step
        change = errors(truth.moved(nudge, np.zeros((4, 3))), seen)[0] - errors(truth, seen)[0]
        assert np.allclose(change / step, by_camera[:, :, column], atol=1e-5)
    for column in range(3):
        nudge = np.zeros((4, 3))
        nudge[:, column] = step
        change = errors(truth.moved(still, nudge), seen)[0] - errors(truth, seen)[0]
        assert np.allclose(change / step, by_point[:, :, column], atol=1e-5)


def test_a_step_solves_all_equations_at_once():
    rng = np.random.default_rng(5)
    truth, seen = town(rng, cameras=4, points=9)
    start = told(truth, rng)
    bundle = Bundle(start.rotation, start.position, triangulated(start.rotation, start.position, seen))
    system = _System.at(bundle, start, seen, BELIEFS, 10.0)
    n, m, damping = 4, 9, 0.01
    whole = np.zeros((6 * n + 3 * m, 6 * n + 3 * m))
    for i in range(n):
        block = system.cameras[i]
        whole[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = block + damping * np.diag(np.diag(block))
    for j in range(m):
        block, at = system.points[j], 6 * n + 3 * j
        whole[at : at + 3, at : at + 3] = block + damping * np.diag(np.diag(block)) + 1e-9 * np.eye(3)
    for i, j, block in zip(system.camera, system.point, system.between):
        rows, columns = slice(6 * i, 6 * i + 6), slice(6 * n + 3 * j, 6 * n + 3 * j + 3)
        whole[rows, columns] += block
        whole[columns, rows] += block.T
    right = -np.concatenate([system.pull_cameras.ravel(), system.pull_points.ravel()])
    cameras, points = system.step(damping)
    assert np.allclose(np.concatenate([cameras.ravel(), points.ravel()]), np.linalg.solve(whole, right), rtol=1e-6)


def test_points_behind_a_camera_are_no_reason_to_fail():
    rng = np.random.default_rng(6)
    truth, seen = town(rng)
    start = told(truth, rng, 0.01, 0.01)
    turned = start.rotation.copy()
    turned[0] = turned[0] @ np.diag([1.0, -1.0, -1.0])  # looks up
    start = Bundle(turned, start.position, start.points)
    found = solve(start, seen, 2.0)
    assert np.isfinite(found.position).all() and np.isfinite(found.points).all()
    others = seen.camera != 0
    rest = Sightings(seen.camera[others], seen.point[others], seen.place[others])
    assert misfit(found, rest) < 0.003


@pytest.mark.parametrize("scale", [0.7, 16.0])
def test_to_see_a_point_from_behind_is_never_cheaper_than_to_see_it_wrong(scale):
    truth, seen = town(np.random.default_rng(7), points=1)
    one = Sightings(seen.camera[:1], seen.point[:1], seen.place[:1])
    ahead = -truth.rotation[0][:, 2]
    wrong, behind = (Bundle(truth.rotation, truth.position, (truth.position[0] + at)[None]) for at in (
        ahead + 50 * truth.rotation[0][:, 0], -ahead,
    ))  # fmt: skip
    assert _cost(behind, truth, one, BELIEFS, scale) > _cost(wrong, truth, one, BELIEFS, scale) > 0


@pytest.mark.parametrize("least", [1, 3])
def test_points_seen_too_seldom_are_left_out_and_numbers_close_up(least):
    seen = Sightings(np.array([0, 1, 2, 0, 1]), np.array([4, 4, 4, 7, 7]), np.arange(10.0).reshape(5, 2))
    kept = seen.repeated(least)
    assert kept.points == (2 if least == 1 else 1)
    assert kept.point.tolist() == ([0, 0, 0, 1, 1] if least == 1 else [0, 0, 0])
    assert kept.place[0].tolist() == [0.0, 1.0]


def test_nothing_seen():
    assert Sightings.none().points == 0


def turned(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations by vectors, and the vectors that are read from them."""
    n = len(vectors)
    here = Bundle(np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3)), np.zeros((0, 3)))
    there = here.moved(np.concatenate([np.zeros((n, 3)), vectors], axis=1), np.zeros((0, 3)))
    return there.rotation, there.from_told(here)[:, 3:]


def test_n81_small_turns_come_back(numeric_row):
    angles = np.array([0.0, 1e-30, 1e-12, 1e-9, 1e-6, 2e-6, 1e-5, 1e-4, 1e-3, 9.9e-3, 1.01e-2, 0.05, 0.3, 1.0, 3.0])
    axes = np.array([(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, -0.48, 0.64)])
    vectors = (angles[:, None, None] * axes).reshape(-1, 3)
    numeric_row("N81", "rotation vectors of 0 to 3 rad, 4 axes", np.abs(turned(vectors)[1] - vectors).max(), 1e-6)


def test_n82_turns_of_almost_half_a_turn_come_back_as_rotations(numeric_row):
    axes = np.random.default_rng(0).standard_normal((100, 3))
    axes = np.concatenate([axes / np.linalg.norm(axes, axis=1, keepdims=True), np.eye(3), -np.eye(3)])
    vectors = np.concatenate([(np.pi - less) * axes for less in (1e-2, 1e-3, 1e-4, 1e-6, 0.0)])
    almost = Rotation.from_quat([0.0, 1.0, 0.0, 1e-12]).as_rotvec()  # (x, y, z, w)
    rotations, found = turned(np.concatenate([vectors, almost[None]]))
    again = Rotation.from_rotvec(found).as_matrix()
    numeric_row(
        "N82", "pi less 0 to 1e-2, 106 axes: rotations", np.linalg.norm(again - rotations, axis=(1, 2)).max(), 1e-5
    )
    numeric_row("N82", "the same: length of the vector beyond pi", np.linalg.norm(found, axis=1).max() - np.pi, 1e-6)
