import math

import numpy as np
import pytest
import torch

from worlds.boxes import Pose, box_at
from worlds.rig import CLEARANCE, Mount, heading_pose, interleaved_splits, lane_poses, pinholes, ring_poses
from worlds.routes import straight

MOUNT = Mount(height=1.6, pitch=-3.0, yaw=10.0, pan=20.0, pan_from=40.0, pan_to=50.0, field_of_view=80.0)


def test_heading_pose_looks_along_yaw_and_pitch():
    pose = heading_pose((1.0, 2.0, 3.0), math.pi / 2, math.pi / 6)
    np.testing.assert_allclose(-pose[:3, 2], [0, math.sqrt(3) / 2, 0.5], atol=1e-6)
    np.testing.assert_allclose(pose[:3, 0], [1, 0, 0], atol=1e-6)


def test_focal_length_of_a_right_angle():
    cameras = pinholes([torch.eye(4)], [90.0])
    assert cameras.focal.tolist() == [[pytest.approx(64.0), pytest.approx(64.0)]]
    assert cameras.centre.tolist() == [[64.0, 64.0]]


@pytest.mark.parametrize(("s", "yaw"), [(0.0, 10.0), (40.0, 10.0), (45.0, 20.0), (50.0, 30.0), (70.0, 30.0)])
def test_mount_pans_between_its_two_arc_lengths(s, yaw):
    forward = -MOUNT.pose(Pose(s, 0.0, 0.0, 0.0), s)[:3, 2]
    assert math.degrees(math.atan2(forward[1], forward[0])) == pytest.approx(yaw, abs=1e-3)
    assert math.degrees(math.asin(forward[2])) == pytest.approx(-3.0, abs=1e-3)


def test_lane_cameras_are_in_order_and_clear_of_the_bodies():
    size, bodies = (4.5, 1.8, 1.4), (12.0, 20.0, 28.0)
    route = straight((0.0, 0.0), 0.0, 60.0)
    poses = lane_poses(route, bodies, size, (1.0, 33.0), 56, MOUNT, np.random.default_rng(0))
    eyes = torch.stack(poses)[:, :3, 3].double().numpy()
    assert len(poses) == 56 and (np.diff(eyes[:, 0]) > 0).all()
    assert eyes[0, 0] >= 1.0 and eyes[-1, 0] <= 33.0
    for s in bodies:
        assert box_at(route.pose(s), size).distance(eyes).min() >= CLEARANCE - 0.01
        beside = np.abs(eyes[:, 0] - s) < size[0] / 2 + CLEARANCE
        assert beside.sum() == 4 and (eyes[beside, 1] > size[1] / 2).all()


def test_ring_cameras_go_round_in_order_and_look_inwards():
    poses = torch.stack(
        ring_poses(43, (2.0, 1.0), (2.0, 1.0, 0.0), (18.0, 25.0), (7.0, 14.0), np.random.default_rng(0))
    ).double()
    offset = poses[:, :2, 3] - torch.tensor([2.0, 1.0])
    azimuth = torch.remainder(torch.atan2(offset[:, 1], offset[:, 0]), 2 * math.pi)
    assert (azimuth.diff() > 0).all()
    assert (offset.norm(dim=1) >= 18).all() and (offset.norm(dim=1) <= 25).all()
    assert (poses[:, 2, 3] >= 7).all() and (poses[:, 2, 3] <= 14).all()
    inward = torch.cat([-offset, -poses[:, 2:3, 3]], 1)
    cosine = (-poses[:, :3, 2] * inward).sum(1) / inward.norm(dim=1)
    assert cosine.min() > math.cos(math.radians(6))


@pytest.mark.parametrize("split", ["train", "test"])
def test_splits_hold_out_at_least_twelve_and_never_an_end(split):
    kinds = ("ego",) * 56 + ("elevated",) * 43 + ("birds_eye",)
    splits = interleaved_splits(kinds, 8, split)
    assert splits[-1] == split and splits[:-1].count("test") == 12
    for end in (0, 55, 56, 98):
        assert splits[end] == "train"
    assert splits[:8].index("test") == 4
