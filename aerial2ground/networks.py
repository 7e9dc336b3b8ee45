"""The paper's network for both tasks (III-C): five convolutions with 8 filters, batch normalisation and ReLU, then two
fully connected layers of 64 and the answer. Larger ones differ by `filters` and `hidden` alone.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from hashnerf.errors import UserError


@dataclass(frozen=True)
class NetworkConfig:
    """Size of the network."""

    filters: int = 8
    """Filters of every convolution (paper: 8)."""
    layers: int = 5
    """Convolutions, each of stride 2 but the last (paper: 5)."""
    hidden: int = 64
    """Units of both fully connected layers (paper: 64)."""
    depth: bool = False
    """Read depth as a fourth channel; views, training, the car's camera and exported policies follow."""

    def __post_init__(self):
        for key in ("filters", "layers", "hidden"):
            if getattr(self, key) < 1:
                raise UserError(f"network.{key} is {getattr(self, key)}; give at least 1")


class PictureNetwork(nn.Module):
    """Pictures in, numbers out."""

    def __init__(self, config: NetworkConfig, height: int, width: int, outputs: int):
        super().__init__()
        self.config, self.height, self.width = config, height, width
        self.channels = 4 if config.depth else 3
        channels, layers = self.channels, []
        for number in range(config.layers):
            stride = 1 if number == config.layers - 1 else 2
            layers += [nn.Conv2d(channels, config.filters, 3, stride, 1), nn.BatchNorm2d(config.filters), nn.ReLU()]
            channels, height, width = config.filters, -(-height // stride), -(-width // stride)
        self.trunk = nn.Sequential(*layers)
        self.head = nn.Sequential(
            nn.Flatten(),
            nn.Linear(config.filters * height * width, config.hidden),
            nn.ReLU(),
            nn.Linear(config.hidden, config.hidden),
            nn.ReLU(),
            nn.Linear(config.hidden, outputs),
        )
        # trained and loaded networks alike: in another layout a processor may sum in another order
        self.to(memory_format=torch.channels_last)

    def forward(self, pictures: Float[Tensor, "n c h w"]) -> Float[Tensor, "n outputs"]:
        """Reads pictures in [0, 1]; raises UserError for another size than the network was made for."""
        if tuple(pictures.shape[2:]) != (self.height, self.width):
            raise UserError(
                f"the network reads pictures of {self.width} x {self.height} pixels, "
                f"not {pictures.shape[3]} x {pictures.shape[2]}; resize them first"
            )
        return self.head(self.trunk(pictures - 0.5))
