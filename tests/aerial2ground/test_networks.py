"""The paper's network: its size and its inputs."""

import pytest
import torch

from aerial2ground.networks import NetworkConfig, PictureNetwork, Smoothing
from hashnerf.errors import UserError


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


def test_a_smoothing_network_sees_means_of_squares_and_no_border():
    torch.manual_seed(0)
    network = PictureNetwork(NetworkConfig(smooth=3), 16, 24, 1).eval()
    plain = PictureNetwork(NetworkConfig(), 16, 24, 1).eval()
    for own, other in zip([one for one in network.trunk if not isinstance(one, torch.nn.AvgPool2d)], plain.trunk):
        other.load_state_dict(own.state_dict())
    plain.head.load_state_dict(network.head.state_dict())
    picture = torch.rand(1, 3, 16, 24)
    # the mean over the part of the square that lies in the picture, pixel by pixel
    rows, columns = range(16), range(24)
    mean = torch.stack([
        torch.stack([
            picture[0, :, max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2].mean(dim=(1, 2)) for x in columns
        ], dim=1)
        for y in rows
    ], dim=1)[None]  # fmt: skip
    assert torch.allclose(network(picture), plain(mean), atol=1e-6)
    assert torch.allclose(network(torch.full_like(picture, 0.3)), plain(torch.full_like(picture, 0.3)), atol=1e-6)


@pytest.mark.parametrize("smooth", [0, 2])
def test_a_square_has_a_middle(smooth):
    with pytest.raises(UserError, match=r"network\.smooth is"):
        NetworkConfig(smooth=smooth)


@pytest.mark.parametrize("memory", [torch.contiguous_format, torch.channels_last])
@pytest.mark.parametrize("size", [3, 5])
def test_smoothing_is_the_mean_over_what_lies_in_the_square(size, memory):
    pictures = torch.rand(3, 4, 9, 13, generator=torch.Generator().manual_seed(0)).contiguous(memory_format=memory)
    expected = torch.nn.functional.avg_pool2d(pictures, size, 1, size // 2, count_include_pad=False)
    assert torch.allclose(Smoothing(size, 1, size // 2, count_include_pad=False)(pictures), expected, atol=1e-6)
