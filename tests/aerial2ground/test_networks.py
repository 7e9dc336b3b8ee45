"""The paper's network: its size and its inputs."""

import pytest
import torch

from aerial2ground.networks import NetworkConfig, PictureNetwork
from hashnerf.errors import UserError
from tests.hashnerf.numerics import LADDER, relative_error


def test_five_convolutions_of_eight_filters_and_two_layers_of_64():
    network = PictureNetwork(NetworkConfig(), 54, 96, 1)
    convolutions = [one for one in network.trunk if isinstance(one, torch.nn.Conv2d)]
    assert [one.out_channels for one in convolutions] == [8] * 5
    assert sum(isinstance(one, torch.nn.BatchNorm2d) for one in network.trunk) == 5
    linear = [one for one in network.head if isinstance(one, torch.nn.Linear)]
    # 54 x 96 halved four times, rounding up: 4 x 6
    assert [(one.in_features, one.out_features) for one in linear] == [(8 * 4 * 6, 64), (64, 64), (64, 1)]


def test_pictures_of_another_size_are_refused():
    network = PictureNetwork(NetworkConfig(), 54, 96, 1)
    with pytest.raises(UserError, match="reads pictures of 96 x 54 pixels, not 64 x 36; resize"):
        network(torch.zeros(1, 3, 36, 64))


def test_depth_is_a_fourth_channel():
    network = PictureNetwork(NetworkConfig(depth=True), 32, 32, 3)
    assert network(torch.zeros(2, 4, 32, 32)).shape == (2, 3)


def test_a_network_without_filters_is_refused():
    with pytest.raises(UserError, match=r"network\.filters is 0"):
        NetworkConfig(filters=0)


def test_t01_precision_of_the_answer(numeric_row):
    network = PictureNetwork(NetworkConfig(), 54, 96, 1).eval()
    pictures = torch.rand(16, 3, 54, 96, generator=torch.Generator().manual_seed(0))
    with torch.no_grad(), torch.autocast("cpu", enabled=False):
        answers = []
        for dtype in LADDER:
            with torch.autocast("cpu", dtype=dtype, enabled=dtype != torch.float32, cache_enabled=False):
                answers.append(network(pictures))
        exact = network.double()(pictures.double())
    errors = [relative_error(answer, exact) for answer in answers]
    for dtype, error, accepted in zip(LADDER, errors, (1e-5, 5e-3, 4e-2)):
        numeric_row("T01", f"policy network, products in {dtype}: relative error of the answer", error, accepted)
    assert errors == sorted(errors)
