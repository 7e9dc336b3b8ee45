"""Poses from pictures: units come back as they went in, and a network learns what pictures tell."""

import math

import numpy as np
import pytest
import torch

from aerial2ground.localisation import (
    Localiser,
    load_localiser,
    pose_distances,
    pose_rmse,
    save_localiser,
    train_localiser,
)
from aerial2ground.networks import NetworkConfig, PictureNetwork
from aerial2ground.policy_training import AugmentationConfig, TaskConfig
from hashnerf.errors import UserError

PLAIN = AugmentationConfig(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_errors_by_hand():
    found = np.array([(3.0, 4.0, 0.1), (0.0, 0.0, math.pi - 0.1)])
    truth = np.array([(0.0, 0.0, 0.0), (0.0, 0.0, -math.pi + 0.1)])
    metres, degrees = pose_distances(found, truth)
    # beyond half a turn the way round is shorter: 0.2 radians
    assert metres == pytest.approx([5.0, 0.0]) and degrees == pytest.approx(np.degrees([0.1, 0.2]))
    assert pose_rmse(found, truth) == pytest.approx((5 / math.sqrt(2), math.degrees(math.sqrt(0.05 / 2))))


class Told(PictureNetwork):
    """Answers the same whatever it sees."""

    def forward(self, pictures):
        return torch.tensor([[0.5, -1.0, 1.0, 0.0]]).expand(len(pictures), 4)


def test_outputs_are_in_units_of_the_training_set():
    localiser = Localiser(Told(NetworkConfig(), 9, 16, 4), np.array([10.0, 20.0]), 2.0)
    pose = localiser(torch.zeros(3, 9, 16, 3, dtype=torch.uint8))
    assert pose.shape == (3, 3) and pose[0] == pytest.approx([11.0, 18.0, math.pi / 2])


def test_a_fifth_and_sixth_output_tell_how_sure_it_is():
    class Sure(PictureNetwork):
        def forward(self, pictures):
            return torch.tensor([[0.5, -1.0, 1.0, 0.0, 0.0, -0.1]]).expand(len(pictures), 6)

    localiser = Localiser(Sure(NetworkConfig(), 9, 16, 6), np.array([10.0, 20.0]), 2.0)
    found = localiser.estimates(torch.zeros(3, 9, 16, 3, dtype=torch.uint8))
    assert found.poses[0] == pytest.approx([11.0, 18.0, math.pi / 2]) and found.deviations.shape == (3, 2)
    # metres for places, radians for yaw
    assert found.deviations[0] == pytest.approx([2 * math.sqrt(3), math.sqrt(3) * math.exp(-0.1)], rel=1e-3)


def striped(poses: np.ndarray) -> torch.Tensor:
    """Pictures that tell the pose: x, y and yaw as brightness of three colours."""
    share = np.column_stack([poses[:, 0] / 4, poses[:, 1] / 4, (poses[:, 2] + 1) / 2]).clip(0, 1)
    return torch.from_numpy((share[:, None, None, :] * np.ones((1, 16, 16, 1)) * 255).astype(np.uint8))


def test_a_network_learns_what_pictures_tell(tmp_path):
    rng = np.random.default_rng(0)
    poses = np.column_stack([rng.uniform(0, 4, (400, 2)), rng.uniform(-1, 1, 400)])
    config = TaskConfig(augmentation=PLAIN, epochs=40)
    localiser = train_localiser([striped(poses[:200]), striped(poses[200:])], [poses[:200], poses[200:]], config, 0)
    metres, degrees = pose_rmse(localiser(striped(poses)), poses)
    assert metres < 0.25 and degrees < 8
    save_localiser(tmp_path / "one", localiser, {})
    again = load_localiser(tmp_path / "one", NetworkConfig())
    assert again.estimates(striped(poses[:5])).deviations is None, "trained by L2 it tells none"
    assert again(striped(poses[:5])) == pytest.approx(localiser(striped(poses[:5])))


def test_who_says_how_sure_it_is_knows_what_pictures_do_not_tell(tmp_path):
    rng = np.random.default_rng(0)
    poses = np.column_stack([rng.uniform(0, 4, (600, 2)), rng.uniform(-1, 1, 600)])
    pictures = striped(poses)
    # every other picture shows neither place nor yaw
    pictures[::2] = 128
    config = TaskConfig(augmentation=PLAIN, epochs=40)
    localiser = train_localiser([pictures], [poses], config, 0, loss="laplace")
    found = localiser.estimates(pictures)
    place, yaw = found.deviations[1::2].mean(axis=0)
    blind_place, blind_yaw = found.deviations[::2].mean(axis=0)
    assert place < 0.5 * blind_place and yaw < 0.5 * blind_yaw
    off = found.poses - poses
    assert blind_place == pytest.approx(off[::2, :2].std(), rel=0.35)
    save_localiser(tmp_path / "sure", localiser, {})
    again = load_localiser(tmp_path / "sure", NetworkConfig()).estimates(pictures[:5])
    assert again.deviations == pytest.approx(found.deviations[:5])


def test_no_network_names_the_script(tmp_path):
    with pytest.raises(UserError, match=r"run scripts/train_localizer\.py first"):
        load_localiser(tmp_path / "none", NetworkConfig())
