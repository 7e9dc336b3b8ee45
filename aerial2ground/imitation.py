"""Learning to steer (IV-D): four data sets, one network, one expert.

imit      pictures of a drive in the town by the expert, as collected: no disturbance but the driver's own
imit_gv   the same, and views of a radiance field made from those pictures, disturbed
ours      disturbed views of the radiance field made from drone pictures alone
ours_gv   both
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from aerial2ground.driving import Policy
from aerial2ground.ground_poses import DisturbanceConfig, GroundPoses
from aerial2ground.networks import PictureNetwork
from aerial2ground.paths import Path
from aerial2ground.policy_training import TaskConfig, as_input, train_network
from aerial2ground.pure_pursuit import PurePursuitConfig, steering
from hashnerf.errors import UserError

METHODS = ("imit", "imit_gv", "ours", "ours_gv")


@dataclass(frozen=True)
class ImitationConfig:
    """Training set and training of the steering network."""

    views: int = 800
    """Ground views per path."""
    disturbance: DisturbanceConfig = field(default_factory=DisturbanceConfig)
    """How far they stray from the path."""
    task: TaskConfig = field(default_factory=TaskConfig)
    """Network and training."""

    def __post_init__(self):
        if self.views < 2:
            raise UserError(f"imitation.views is {self.views}; give at least 2")


def expert_steering(path: Path, car: GroundPoses, config: PurePursuitConfig) -> Float[np.ndarray, " n"]:
    """Returns what the expert would steer at every pose."""
    return np.array([steering(path, pose, config) for pose in car.poses])


def train_policy(
    pictures: Sequence[UInt8[Tensor, "_ h w c"]],
    steerings: Sequence[Float[np.ndarray, " _"]],
    config: TaskConfig,
    limit: float,
    seed: int,
    skies: Sequence[Bool[Tensor, "_ h w"]] | None = None,
) -> PictureNetwork:
    """Trains the steering network on one or several sets of pictures; it learns steering over `limit` (L1).

    `skies` say where nothing is in the pictures, as far as that is known.
    """
    targets = torch.from_numpy(np.concatenate(list(steerings))).float()[:, None] / limit
    sky = None if skies is None else torch.cat(list(skies))
    return train_network(config, torch.cat(list(pictures)), targets, "l1", seed, sky)


def network_policy(network: PictureNetwork, limit: float) -> Policy:
    """Returns a policy that steers by what the network sees."""
    answer = network_answer(network, limit)
    return lambda picture, state: answer(picture)


def network_answer(network: PictureNetwork, limit: float) -> Callable[[UInt8[np.ndarray, "h w c"]], float]:
    """Returns a function from a picture to the network's steering, radians; depth that it does not read is left out."""

    @torch.no_grad()
    def answer(picture: UInt8[np.ndarray, "h w c"]) -> float:
        read = torch.from_numpy(picture[..., : network.channels])
        return float(network(as_input(read[None]))[0, 0]) * limit

    return answer


def expert_policy(path: Path, config: PurePursuitConfig) -> Policy:
    """Returns the expert, who knows where the car is."""
    return lambda picture, state: steering(path, state.pose, config)
