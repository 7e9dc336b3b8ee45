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
    pose_targets,
    save_localiser,
    train_localiser,
)
from aerial2ground.losses import loss_of
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


def test_n91_n95_yaw_errors_are_wrapped(numeric_row):
    one, other = np.array([(0.0, 0.0, 3.13)]), np.array([(0.0, 0.0, -3.13)])
    degrees = pose_rmse(one, other)[1]
    numeric_row("N95", "yaws 3.13 and -3.13: radians", abs(math.radians(degrees) - (2 * math.pi - 6.26)), 1e-9)
    far = np.array([(0.0, 0.0, 0.3 + turns * 2 * math.pi) for turns in (0, 1, -1, 10_000)])
    numeric_row("N91", "0.3 after 10,000 turns: radians", math.radians(pose_rmse(far, far[:1].repeat(4, 0))[1]), 1e-6)


def targets(*yaws: float) -> torch.Tensor:
    poses = np.array([(0.0, 0.0, yaw) for yaw in yaws])
    return torch.from_numpy(pose_targets(poses, np.zeros(2), 1.0)).float()


def test_n90_the_loss_of_a_yaw_has_no_seam(numeric_row):
    loss = loss_of("l2")
    yaw = torch.tensor([math.pi - 0.01], requires_grad=True)
    zero = torch.zeros(1)
    told, wanted = torch.stack([zero, zero, yaw.sin(), yaw.cos()], dim=1), targets(-math.pi + 0.01)
    squared = 4 * loss(told, wanted)  # the mean is over four numbers
    numeric_row("N90", "pi - 0.01 for -pi + 0.01: squared error", abs(float(squared.detach()) - 4e-4), 1e-6)
    (slope,) = torch.autograd.grad(squared, yaw)
    numeric_row("N90", "the same: turned the long way", not float(slope) < 0)
    worst, bad = 0.0, 0
    for d in (0.0, math.pi, -math.pi, math.pi + 1e-6, math.pi - 1e-6, 2 * math.pi, 1e4 * 2 * math.pi + 0.3, 1e8):
        answer = targets(0.5).requires_grad_()
        losses = [loss(answer, targets(0.5 + d + turns * 2 * math.pi)) for turns in (0, 1, -3)]
        worst = max(worst, *(abs(float((one - losses[0]).detach())) for one in losses))
        (slope,) = torch.autograd.grad(losses[0], answer)
        bad += not bool(slope.isfinite().all() and losses[0].isfinite())
    numeric_row("N90", "differences up to 1e8, whole turns more: change of the error", worst, 1e-6)
    numeric_row("N90", "the same: not finite", bad)


def test_n90_n124_poses_that_cannot_be_learned_are_refused(numeric_row):
    pictures, config = torch.zeros(2, 16, 16, 3, dtype=torch.uint8), TaskConfig(augmentation=PLAIN, epochs=1)
    unsound = np.array([(0.0, 0.0, math.nan), (0.0, 0.0, 0.0)])
    with pytest.raises(UserError, match="a pose of one is not finite") as refused:
        train_localiser([pictures], [unsound], config, 0)
    numeric_row("N90", "a yaw that is NaN: taken in", refused is None)
    for count in (0, 1):
        with pytest.raises(UserError, match=f"{count} training pictures") as refused:
            train_localiser([pictures[:count]], [np.zeros((count, 3))], config, 0)
        numeric_row("N124", f"{count} training pictures: taken in", refused is None)
    same = train_localiser([pictures], [np.ones((2, 3))], config, 0)
    numeric_row("N124", "two pictures at one place: pose not finite", not np.isfinite(same(pictures)).all())


def test_n125_the_spread_of_places_far_from_the_origin(numeric_row):
    places = 1000 + 2e-3 * np.random.default_rng(0).standard_normal((200, 3))
    pictures = torch.zeros(200, 16, 16, 3, dtype=torch.uint8)
    found = train_localiser([pictures], [places], TaskConfig(augmentation=PLAIN, epochs=1), 0).scale
    exact = math.sqrt(math.fsum((x - 1000) ** 2 for x in places[:, :2].flat) / 400 - (places[:, :2].mean() - 1000) ** 2)
    numeric_row("N125", "200 places 1000 m away, 2 mm apart: scale", abs(found / exact - 1), 1e-3)


def test_n94_a_yaw_without_a_direction(numeric_row):
    class Nowhere(PictureNetwork):
        def forward(self, pictures):
            return torch.tensor([[0.0, 0.0, 0.0, 0.0, 1.0, 8.0], [0.0, 0.0, 1e-30, 0.0, 1.0, 8.0]])

    localiser = Localiser(Nowhere(NetworkConfig(), 9, 16, 6), np.zeros(2), 1.0)
    found = localiser.estimates(torch.zeros(2, 9, 16, 3, dtype=torch.uint8))
    numeric_row("N94", "sine and cosine (0, 0) and (1e-30, 0): not finite", (~np.isfinite(found.poses)).sum())
    # what tells that such a yaw is worth nothing is the deviation that the network tells beside it
    numeric_row("N94", "the same: said to be sure of it", (found.deviations[:, 1] < math.pi).sum())


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
