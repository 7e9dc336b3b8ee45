"""What is known of a road before any picture: its colour, its distance, and that a car fits above it (III-B, Alg. 1).

Rays go straight down on the road: from the flying height, as in the paper, or from lower where crowns hang over roads.
What hides the road from the air would be carved away by a ray that starts above it. Where the space above roads is
free, their distance is known from every place in it: further rays look along the road as a car does, to which a fog of
a few millimetres, which no ray from above minds, is a wall.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from aerial2ground.road_network import RoadNetwork
from hashnerf.errors import UserError
from hashnerf.rays import Rays

LOWEST = 0.2
"""Height of the lowest place from which rays look along the road, as a share of a car's height."""
FLATTEST = 10.0
"""How many times its height such a ray may travel over the road."""


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
    grazing: float = 0.5
    """Share of the rays that look along the road from within the free space; no effect without depth and free space."""
    margin: float = 0.02
    """Metres above the road from which it must be free: the road itself is a layer of fog at first."""

    def __post_init__(self):
        if not 0 <= self.share <= 10:
            raise UserError(f"road_prior.share is {self.share}; give a number from 0 to 10")
        if not 0 <= self.grazing <= 1:
            raise UserError(f"road_prior.grazing is {self.grazing}; give a number from 0 to 1")
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
    """Rays that end on roads and points above them."""

    rays: Rays
    rgb: Float[Tensor, "rays 3"]
    weight: Float[Tensor, " rays"]
    distance: Float[Tensor, " rays"]
    empty: Float[Tensor, "rays 3"]


def draw_prior(
    network: RoadNetwork, config: RoadPriorConfig, flying_height: float, count: int, generator: torch.Generator
) -> PriorBatch:
    """Draws `count` rays normal to the road or along it, and as many points in the free space above it."""
    ground, colour = network.sample(count, generator)
    up = torch.tensor([0.0, 0.0, 1.0])
    way = (config.start or flying_height) * up.expand(count, 3)
    if config.depth and config.free_space and config.grazing:
        along, usable = _ways_along(network, config.car_height, ground, generator)
        usable &= torch.arange(count) < config.grazing * count
        way = torch.where(usable[:, None], along, way)
    length = way.norm(dim=1)
    rays = Rays(ground + way, -way / length[:, None])
    level = config.margin + (config.car_height - config.margin) * torch.rand(count, 1, generator=generator)
    above, _ = network.sample(count, generator)
    weight = torch.full((count,), config.colour_weight if config.colour else 0.0)
    distance = length if config.depth else torch.full((count,), math.nan)
    return PriorBatch(rays, colour, weight, distance, above + level * up)


def _ways_along(
    network: RoadNetwork, car_height: float, ground: Float[Tensor, "rays 3"], generator: torch.Generator
) -> tuple[Float[Tensor, "rays 3"], Bool[Tensor, " rays"]]:
    """Returns ways (m) from points of the road to low places in any direction, and which stay above free road."""
    height, slope, turn = torch.rand(3, len(ground), generator=generator)
    height = car_height * (LOWEST + (1 - LOWEST) * height)
    away = height * FLATTEST**slope
    turn = 2 * math.pi * turn
    way = torch.stack([away * turn.cos(), away * turn.sin(), height], dim=1)
    usable = torch.ones(len(ground), dtype=torch.bool)
    for share in (0.25, 0.5, 0.75, 1.0):
        place = ground + share * way
        road, distance = network.nearest(place[:, :2])
        above = place[:, 2] - road
        usable &= (distance <= network.width / 2) & (above > 0) & (above <= car_height)
    return way, usable
