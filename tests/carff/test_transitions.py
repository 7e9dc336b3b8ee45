import math

import pytest
import torch

from carff.transitions import TransitionConfig, TransitionSampler, ViewBeliefs, camera_distances, camera_neighbours
from hashnerf.errors import UserError


def ring(angles: list[float], radius: float = 10.0) -> torch.Tensor:
    """Cameras on a horizontal circle that look at its centre."""
    poses = torch.eye(4).repeat(len(angles), 1, 1)
    for pose, angle in zip(poses, angles):
        back = torch.tensor([math.cos(angle), math.sin(angle), 0.0])
        right = torch.tensor([-math.sin(angle), math.cos(angle), 0.0])
        pose[:3, :3] = torch.stack([right, torch.tensor([0.0, 0.0, 1.0]), back], dim=1)
        pose[:3, 3] = radius * back
    return poses


def views(means: list[list[float]], valid: list[list[bool]] | None = None, logvar: float = -4.0) -> ViewBeliefs:
    tensor = torch.tensor(means)[:, :, None]
    mask = torch.ones(tensor.shape[:2], dtype=torch.bool) if valid is None else torch.tensor(valid)
    return ViewBeliefs(tensor, torch.full_like(tensor, logvar), mask)


def drawn_targets(sampler: TransitionSampler, source_mean: float, batches: int = 40) -> torch.Tensor:
    """Means of the targets that were drawn for sources near a mean."""
    parts = [sampler.batch(step, 128) for step in range(batches)]
    sources = torch.cat([part.source.mean for part in parts])[:, 0]
    targets = torch.cat([part.target.mean for part in parts])[:, 0]
    return targets[(sources - source_mean).abs() < 0.2]


# --- neighbours ---


def test_distance_by_hand():
    # Two cameras 20 m apart that look at each other: radius of the rig 10, angle pi: 20 + 10 pi.
    distances = camera_distances(ring([0.0, math.pi]))
    assert distances.tolist() == [[0.0, pytest.approx(20 + 10 * math.pi)], [pytest.approx(20 + 10 * math.pi), 0.0]]


def test_distances_are_symmetric_and_their_order_ignores_the_scale_of_the_world():
    torch.manual_seed(0)
    poses = ring((6 * torch.rand(12)).tolist())
    poses[:, :3, 3] += torch.randn(12, 3)
    scaled = poses.clone()
    scaled[:, :3, 3] *= 40
    assert torch.allclose(camera_distances(poses), camera_distances(poses).T)
    assert torch.equal(camera_neighbours(poses), camera_neighbours(scaled))


def test_neighbours_go_round_the_ring_and_do_not_depend_on_numbering():
    order = [3, 0, 4, 1, 5, 2]
    poses = ring([place * math.pi / 3 for place in order])
    for camera, row in enumerate(camera_neighbours(poses)[:, :3].tolist()):
        assert row[0] == camera
        places = {order[other] for other in row}
        assert places == {order[camera], (order[camera] + 1) % 6, (order[camera] - 1) % 6}


def test_a_line_of_cameras_does_not_wrap():
    poses = torch.eye(4).repeat(5, 1, 1)
    poses[:, 0, 3] = torch.arange(5.0)
    assert camera_neighbours(poses)[:, :3].tolist() == [[0, 1, 2], [1, 0, 2], [2, 1, 3], [3, 2, 4], [4, 3, 2]]


def test_the_direction_of_view_counts():
    # Camera 1 stands where camera 0 does but looks away; camera 2 stands 3 m off and looks along with it.
    poses = torch.eye(4).repeat(4, 1, 1)
    poses[1, :3, :3] = torch.diag(torch.tensor([-1.0, 1.0, -1.0]))
    poses[2, 0, 3], poses[3, 0, 3] = 3.0, 9.0
    assert camera_neighbours(poses)[0].tolist() == [0, 2, 3, 1]


def test_cameras_at_one_place_are_ordered_by_angle_and_each_is_its_own_first():
    poses = ring([0.0, 2.0, 0.5, 0.0], radius=0.0)
    neighbours = camera_neighbours(poses).tolist()
    assert neighbours[0] == [0, 3, 2, 1] and neighbours[3] == [3, 0, 2, 1]


def test_held_out_cameras_take_no_place():
    poses = torch.eye(4).repeat(4, 1, 1)
    poses[:, 0, 3] = torch.arange(4.0)
    usable = torch.tensor([True, False, True, True])
    assert camera_neighbours(poses, usable)[0].tolist() == [0, 2, 3, 1]


# --- pairs ---


def test_targets_are_the_next_state_and_the_last_state_is_no_source():
    # Three steps at means 0, 10, 20 seen alike by two cameras: 0 -> 10, 10 -> 20.
    sampler = TransitionSampler(
        views([[0.0, 0.0], [10.0, 10.0], [20.0, 20.0]]),
        torch.tensor([1, 2, -1]),
        ring([0.0, 1.0]),
        TransitionConfig(),
        0,
    )
    assert sampler.sources.tolist() == [[0, 0], [0, 1], [1, 0], [1, 1]]
    assert set(drawn_targets(sampler, 0.0).tolist()) == {10.0}
    assert set(drawn_targets(sampler, 10.0).tolist()) == {20.0}
    assert len(drawn_targets(sampler, 20.0)) == 0


def test_branches_of_different_length_keep_to_themselves():
    # Branch a: 0 -> 1 -> 2, branch b: 100 -> 101.
    sampler = TransitionSampler(
        views([[0.0], [1.0], [2.0], [100.0], [101.0]]),
        torch.tensor([1, 2, -1, 4, -1]),
        ring([0.0]),
        TransitionConfig(),
        0,
    )
    everything = sampler.all_sources(torch.Generator().manual_seed(0))
    assert (everything.target.mean - everything.source.mean).flatten().tolist() == [1.0, 1.0, 1.0]


def test_states_are_drawn_by_their_weight():
    # Equal pictures now, 1 or 9 next; the second branch happens three times as often.
    successor, weight = torch.tensor([1, -1, 3, -1]), torch.tensor([0.25, 0.25, 0.75, 0.75])
    beliefs = views([[0.0], [1.0], [0.0], [9.0]])
    for weights, share in ((None, 0.5), (weight, 0.75)):
        sampler = TransitionSampler(beliefs, successor, ring([0.0]), TransitionConfig(), 0, weights)
        targets = drawn_targets(sampler, 0.0)  # 5120 pairs: a standard error of 0.006 to 0.007
        assert (targets == 9).float().mean().item() == pytest.approx(share, abs=0.03)


def test_targets_prefer_cameras_that_can_tell_the_next_state():
    # Two branches, states 0 -> 1 and 2 -> 3. After the step, camera 0 sees 5 in both, camera 1 sees 4 and 6.
    means = [[0.0, 0.0], [5.0, 4.0], [0.0, 0.0], [5.0, 6.0]]
    sampler = TransitionSampler(views(means), torch.tensor([1, -1, 3, -1]), ring([0.0, 0.3]), TransitionConfig(), 0)
    targets = drawn_targets(sampler, 0.0)
    assert ((targets == 5.0).double().mean()) < 0.01
    low = float((targets == 4.0).double().mean())
    assert abs(low - 0.5) < 4 * math.sqrt(0.25 / len(targets))


def test_draws_follow_distinctness():
    # Next state at camera 0: beliefs 0.4 apart with variance e^-4, overlap exp(-0.16 e^4 / 8) = 0.3355; camera 1: 100
    # apart, overlap 0. So camera 0 is drawn with 0.6645 / 1.6645 = 0.3992 (floor 0).
    means = [[0.0, 0.0], [5.0, 50.0], [0.0, 0.0], [5.4, -50.0]]
    config = TransitionConfig(distinctness_floor=0.0)
    sampler = TransitionSampler(views(means), torch.tensor([1, -1, 3, -1]), ring([0.0, 0.3]), config, 0)
    torch.testing.assert_close(sampler.log_probability[0].exp(), torch.tensor([0.3992, 0.6008]), atol=1e-4, rtol=0)
    targets = drawn_targets(sampler, 0.0, batches=80)
    share = float(((targets - 5.2).abs() < 1).double().mean())
    assert abs(share - 0.3992) < 4 * math.sqrt(0.24 / len(targets))


def test_where_no_camera_tells_all_are_drawn_alike():
    # States 1 and 3 look the same from cameras 0 and 1; camera 2 is too far to be a neighbour of theirs.
    means = [[0.0, 0.0, 9.0], [5.0, 6.0, 1.0], [0.0, 0.0, 9.0], [5.0, 6.0, 2.0]]
    config = TransitionConfig(neighbours=2, clear_neighbours=0.0, distinctness_floor=0.0)
    sampler = TransitionSampler(views(means), torch.tensor([1, -1, 3, -1]), ring([0.0, 0.1, 3.0]), config, 0)
    torch.testing.assert_close(sampler.log_probability[0].exp(), torch.tensor([0.5, 0.5, 0.0]))


def test_the_neighbourhood_grows_until_it_sees_the_next_state():
    # On a line of six cameras the next states look alike from 0, 1, 2 and differ from 3, 4, 5.
    means = [[0.0] * 6, [5.0, 5.0, 5.0, 7.0, 7.0, 7.0], [0.0] * 6, [5.0, 5.0, 5.0, 9.0, 9.0, 9.0]]
    poses = torch.eye(4).repeat(6, 1, 1)
    poses[:, 0, 3] = torch.arange(6.0)

    def probability(camera: int, clear_neighbours: float) -> list[float]:
        config = TransitionConfig(neighbours=2, clear_neighbours=clear_neighbours, distinctness_floor=0.0)
        sampler = TransitionSampler(views(means), torch.tensor([1, -1, 3, -1]), poses, config, 0)
        by_camera = torch.zeros(6)
        by_camera[sampler.neighbours[camera]] = sampler.log_probability[camera].exp()
        return by_camera.tolist()

    # Overlap exp(-4 e^4 / 8) is nearly 0, so each clear camera counts 1.
    assert probability(0, 2.0) == pytest.approx([0, 0, 0, 0.5, 0.5, 0], abs=1e-6)
    assert probability(0, 0.0) == pytest.approx([0.5, 0.5, 0, 0, 0, 0])
    # From camera 4 the two nearest (itself and 3) suffice.
    assert probability(4, 2.0) == pytest.approx([0, 0, 0, 0.5, 0.5, 0], abs=1e-6)


def test_missing_views_are_neither_source_nor_target():
    valid = [[True, False], [True, True]]
    sampler = TransitionSampler(
        views([[0.0, math.nan], [5.0, 6.0]], valid), torch.tensor([1, -1]), ring([0.0, 0.1]), TransitionConfig(), 0
    )
    assert sampler.sources.tolist() == [[0, 0]]
    other = TransitionSampler(
        views([[0.0, 1.0], [5.0, math.nan]], [[True, True], [True, False]]),
        torch.tensor([1, -1]),
        ring([0.0, 0.1]),
        TransitionConfig(),
        0,
    )
    assert set(torch.cat([other.batch(s, 64).target.mean for s in range(5)]).flatten().tolist()) == {5.0}


# --- batches ---


def test_samples_have_the_moments_of_the_true_posterior():
    # Standard deviation exp(logvar / 2) = 2, not the variance 4, and normal rather than uniform.
    sampler = TransitionSampler(
        views([[0.0], [10.0]], logvar=math.log(4.0)),
        torch.tensor([1, -1]),
        ring([0.0]),
        TransitionConfig(samples=64),
        0,
    )
    samples = torch.cat([sampler.batch(step, 128).samples for step in range(20)]).flatten().double()
    assert float(samples.mean()) == pytest.approx(10, abs=4 * 2 / math.sqrt(len(samples)))
    assert float(samples.std()) == pytest.approx(2, rel=0.01)
    kurtosis = float(((samples - 10) / 2).pow(4).mean())
    assert kurtosis == pytest.approx(3, abs=0.1)  # a uniform distribution has 1.8


def test_noise_on_the_source_lies_between_its_bounds():
    config = TransitionConfig(noise_low=0.001, noise_high=0.01)
    sampler = TransitionSampler(views([[0.0], [1.0]]), torch.tensor([1, -1]), ring([0.0]), config, 0)
    parts = [sampler.batch(step, 256).source for step in range(40)]
    # The mean square of sigma uniform in [a, b] is (a^2 + a b + b^2) / 3.
    expected = math.sqrt((1e-6 + 1e-5 + 1e-4) / 3)
    for noise in (torch.cat([part.mean for part in parts]), torch.cat([part.logvar for part in parts]) + 4):
        assert float(noise.std()) == pytest.approx(expected, rel=0.05)


def test_a_batch_is_a_function_of_seed_and_step():
    def sampler(seed: int) -> TransitionSampler:
        return TransitionSampler(
            views([[0.0, 0.1], [1.0, 1.1]]), torch.tensor([1, -1]), ring([0.0, 1.0]), TransitionConfig(), seed
        )

    first = sampler(3)
    first.batch(0, 16)
    again, other_seed = sampler(3).batch(7, 16), sampler(4).batch(7, 16)
    assert torch.equal(first.batch(7, 16).samples, again.samples)
    assert torch.equal(first.batch(7, 16).source.mean, again.source.mean)
    assert not torch.equal(first.batch(8, 16).samples, again.samples)
    assert not torch.equal(other_seed.samples, again.samples)


# --- errors ---


def test_one_step_cannot_train_a_forecast():
    with pytest.raises(UserError, match="two steps"):
        TransitionSampler(views([[0.0], [1.0]]), torch.tensor([-1, -1]), ring([0.0]), TransitionConfig(), 0)


@pytest.mark.parametrize("bad", [math.nan, 1e20])
def test_beliefs_that_are_not_usable_are_refused(bad):
    with pytest.raises(UserError, match="means of the encoded views: row 1"):
        TransitionSampler(views([[0.0], [bad]]), torch.tensor([1, -1]), ring([0.0]), TransitionConfig(), 0)


@pytest.mark.parametrize(
    "change",
    [
        {"neighbours": 0},
        {"clear_neighbours": -1.0},
        {"samples": 0},
        {"noise_low": 0.1},
        {"noise_low": -0.1},
        {"distinctness_floor": -1.0},
    ],
)
def test_impossible_settings_are_refused_by_name(change):
    with pytest.raises(UserError, match=rf"transitions\.{next(iter(change))}"):
        TransitionConfig(**change)
