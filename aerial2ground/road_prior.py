"""What is known of a road before any picture: its colour, its distance, and that a car fits above it (III-B, Alg. 1).

Rays go straight down on the road: from the flying height, as in the paper, or from lower where crowns hang over roads.
What hides the road from the air would be carved away by a ray that starts above it.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from aerial2ground.road_network import RoadNetwork
from hashnerf.errors import UserError
from hashnerf.rays import Rays


@dataclass(frozen=True)
class RoadPriorConfig:
    """Which parts of the road prior are used, and how strongly."""

    colour: bool = True
    """Rays down on the road should see its colour."""
    depth: bool = True
    """Rays down on the road should stop at its surface."""
    free_space: bool = True
    """Nothing should stand on the road up to the height of a car."""
    share: float = 0.1
    """Rays of the prior for every ray of the pictures."""
    colour_weight: float = 0.05
    """Weight of the colour error of such a ray; marks on the road have other colours, so less than a picture's."""
    start: float = 0.35
    """Metres above the road at which the rays start; 0: at the flying height."""
    car_height: float = 0.25
    """Metres above the road that are free."""
    margin: float = 0.02
    """Metres above the road from which it must be free: the road itself is a layer of fog at first."""

    def __post_init__(self):
        if not 0 <= self.share <= 10:
            raise UserError(f"road_prior.share is {self.share}; give a number from 0 to 10")
        for name in ("colour_weight", "start"):
            if not 0 <= getattr(self, name) < math.inf:
                raise UserError(f"road_prior.{name} is {getattr(self, name)}; give 0 or a positive number")
        if not 0 <= self.margin < self.car_height < math.inf:
            raise UserError(
                f"road_prior.margin is {self.margin} and car_height {self.car_height}; give 0 <= margin < car_height"
            )

    @property
    def used(self) -> bool:
        """Whether there is any prior."""
        return self.share > 0 and (self.colour or self.depth or self.free_space)


_PRIOR = "--reconstruction.road_prior"
VARIANTS = {
    "none": (f"{_PRIOR}.share", "0"),
    "colour": (f"{_PRIOR}.depth", "false", f"{_PRIOR}.free_space", "false"),
    "colour_depth": (f"{_PRIOR}.free_space", "false"),
    "full": (),
}
"""The parts of the prior that are compared (Fig. 5, with numbers), as options of the scripts."""


@dataclass(frozen=True)
class PriorBatch:
    """Rays down on roads and points above them."""

    rays: Rays
    rgb: Float[Tensor, "rays 3"]
    weight: Float[Tensor, " rays"]
    distance: Float[Tensor, " rays"]
    empty: Float[Tensor, "rays 3"]


def draw_prior(
    network: RoadNetwork, config: RoadPriorConfig, flying_height: float, count: int, generator: torch.Generator
) -> PriorBatch:
    """Draws `count` rays normal to the road and as many points in the free space above it."""
    ground, colour = network.sample(count, generator)
    height = config.start or flying_height
    up = torch.tensor([0.0, 0.0, 1.0])
    rays = Rays(ground + height * up, (-up).expand(count, 3).contiguous())
    level = config.margin + (config.car_height - config.margin) * torch.rand(count, 1, generator=generator)
    above, _ = network.sample(count, generator)
    weight = torch.full((count,), config.colour_weight if config.colour else 0.0)
    distance = torch.full((count,), height if config.depth else math.nan)
    return PriorBatch(rays, colour, weight, distance, above + level * up)
