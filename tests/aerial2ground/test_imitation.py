"""The expert's labels, and policies made of networks."""

import math

import numpy as np
import pytest
import torch

from aerial2ground.car import CarState
from aerial2ground.ground_poses import DisturbanceConfig, disturbed_poses
from aerial2ground.imitation import (
    ImitationConfig,
    expert_policy,
    expert_steering,
    network_answer,
    network_policy,
    train_policy,
)
from aerial2ground.networks import NetworkConfig, PictureNetwork
from aerial2ground.paths import Path
from aerial2ground.policy_training import TaskConfig
from aerial2ground.pure_pursuit import PurePursuitConfig, steering
from hashnerf.errors import UserError

ANGLE = np.linspace(0, 2 * math.pi, 721)
CIRCLE = Path(1.5 * np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1))
PURSUIT = PurePursuitConfig()


def test_the_expert_needs_no_picture():
    state = CarState(1.6, 0.0, math.pi / 2)
    nothing = np.zeros((1, 1, 3), np.uint8)
    assert expert_policy(CIRCLE, PURSUIT)(nothing, state) == steering(CIRCLE, state.pose, PURSUIT)


def test_a_network_is_asked_for_the_share_of_the_limit():
    network = PictureNetwork(NetworkConfig(), 36, 64, 1).eval()
    with torch.no_grad():
        network.head[-1].weight.zero_()
        network.head[-1].bias.fill_(0.5)
    assert network_policy(network, 0.4)(np.zeros((36, 64, 3), np.uint8), CarState(0.0, 0.0, 0.0)) == pytest.approx(0.2)


def test_the_answer_needs_no_state():
    network = PictureNetwork(NetworkConfig(depth=True), 36, 64, 1).eval()
    picture = np.random.default_rng(0).integers(0, 256, (36, 64, 4), dtype=np.uint8)
    wanted = network_policy(network, 0.4)(picture, CarState(0.0, 0.0, 0.0))
    assert network_answer(network, 0.4)(picture) == wanted != 0


def test_a_policy_learns_the_experts_steering_over_the_limit():
    car = disturbed_poses(CIRCLE, 40, DisturbanceConfig(), np.random.default_rng(0))
    wanted = expert_steering(CIRCLE, car, PURSUIT)
    assert (np.abs(wanted) <= PURSUIT.steering_limit).all() and wanted.std() > 0.05
    pictures = torch.randint(0, 255, (20, 36, 64, 3), dtype=torch.uint8)
    network = train_policy([pictures, pictures], [wanted[:20], wanted[20:]], TaskConfig(epochs=1), 0.4189, seed=0)
    assert (network.height, network.width) == (36, 64)


def test_no_views_are_refused():
    with pytest.raises(UserError, match=r"imitation\.views is 0"):
        ImitationConfig(views=0)
