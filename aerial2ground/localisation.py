"""Where is the car? The paper's network tells position and yaw from one picture (III-D; L2, yaw as sine and cosine).

With `laplace` in place of L2 it also tells how sure it is of either.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from aerial2ground.losses import LossName, deviations
from aerial2ground.networks import NetworkConfig, PictureNetwork
from aerial2ground.policy_training import TaskConfig, as_input, train_network
from hashnerf.checkpoints import load_checkpoint, load_module_state, module_tensors, save_checkpoint
from hashnerf.errors import UserError

AT_ONCE = 512


@dataclass(frozen=True)
class LocalisationConfig:
    """Training of the network that tells poses."""

    task: TaskConfig = field(default_factory=TaskConfig)
    """Network and training."""
    loss: Literal["l2", "laplace"] = "l2"
    """Squared error (paper), or `laplace`: the network also tells how sure it is."""


@dataclass(frozen=True)
class Estimates:
    """What a network makes of pictures."""

    poses: Float[np.ndarray, "n 3"]
    """(x, y, yaw), metres and radians."""
    deviations: Float[np.ndarray, "n 2"] | None
    """Standard deviations that it tells, of x and of y (metres) and of yaw (radians); None where it tells none."""


@dataclass(frozen=True)
class Localiser:
    """A network whose first two outputs are positions in units of `scale` metres from `centre`, then sine and cosine.

    A fifth and sixth output say how sure it is of the position and of the yaw.
    """

    network: PictureNetwork
    centre: Float[np.ndarray, " 2"]
    scale: float

    @torch.no_grad()
    def estimates(self, pictures: UInt8[Tensor, "n h w c"]) -> Estimates:
        """Returns what the network makes of each picture; depth that it does not read is left out."""
        parts = [self.network(as_input(part)) for part in pictures[..., : self.network.channels].split(AT_ONCE)]
        out = torch.cat(parts).double()
        place, yaw = out[:, :2].numpy() * self.scale + self.centre, torch.atan2(out[:, 2], out[:, 3]).numpy()
        told = deviations(out[:, 4:]).numpy() * [self.scale, 1.0] if out.shape[1] > 4 else None
        return Estimates(np.column_stack([place, yaw]), told)

    def __call__(self, pictures: UInt8[Tensor, "n h w c"]) -> Float[np.ndarray, "n 3"]:
        """Returns (x, y, yaw) of each picture, metres and radians."""
        return self.estimates(pictures).poses


def train_localiser(
    pictures: Sequence[UInt8[Tensor, "_ h w c"]],
    poses: Sequence[Float[np.ndarray, "_ 3"]],
    config: TaskConfig,
    seed: int,
    skies: Sequence[Bool[Tensor, "_ h w"]] | None = None,
    loss: LossName = "l2",
) -> Localiser:
    """Trains on one or several sets of pictures and the poses (x, y, yaw) of the car that took them.

    `skies` say where nothing is in the pictures, as far as that is known.
    """
    place = np.concatenate(list(poses))
    if not len(place) or not np.isfinite(place).all():
        raise UserError(f"{len(place)} training pictures: there is none, or a pose of one is not finite")
    centre = place[:, :2].mean(axis=0)
    scale = max(float(place[:, :2].std()), 1e-3)
    targets = torch.from_numpy(pose_targets(place, centre, scale)).float()
    sky = None if skies is None else torch.cat(list(skies))
    return Localiser(train_network(config, torch.cat(list(pictures)), targets, loss, seed, sky), centre, scale)


def pose_targets(
    poses: Float[np.ndarray, "n 3"], centre: Float[np.ndarray, " 2"], scale: float
) -> Float[np.ndarray, "n 4"]:
    """Returns what the network is to answer: positions in its units, sine and cosine of the yaw.

    No yaw has a seam then. Where it is wrong by half a turn the squared error is largest and pulls it neither way.
    """
    return np.concatenate([(poses[:, :2] - centre) / scale, np.sin(poses[:, 2:]), np.cos(poses[:, 2:])], axis=1)


def save_localiser(folder: Path, localiser: Localiser, made_from: Mapping) -> None:
    """Saves the network with the units of its outputs and what it was made from."""
    network = localiser.network
    about = {"height": network.height, "width": network.width, "outputs": network.head[-1].out_features}
    about |= {"centre": localiser.centre.tolist(), "scale": localiser.scale}
    about |= {"made_from": dict(made_from)}
    save_checkpoint(folder, 0, module_tensors(network, "network"), about, keep=1)


def load_localiser(folder: Path, config: NetworkConfig) -> Localiser:
    """Loads a localiser; raises UserError where there is none."""
    if not folder.is_dir():
        raise UserError(f"{folder}: no trained network here; run scripts/train_localizer.py first")
    _, tensors, about = load_checkpoint(folder)
    network = PictureNetwork(config, about["height"], about["width"], about["outputs"])
    load_module_state(network, tensors, "network")
    return Localiser(network.eval(), np.array(about["centre"]), about["scale"])


def pose_rmse(found: Float[np.ndarray, "n 3"], truth: Float[np.ndarray, "n 3"]) -> tuple[float, float]:
    """Returns root mean square errors: metres between positions, degrees between yaws."""
    metres, degrees = pose_distances(found, truth)
    return float(np.sqrt(np.mean(metres**2))), float(np.sqrt(np.mean(degrees**2)))


def pose_distances(
    found: Float[np.ndarray, "n 3"], truth: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Returns metres between positions and degrees, 0 to 180, between yaws."""
    turn = np.remainder(found[:, 2] - truth[:, 2] + np.pi, 2 * np.pi) - np.pi
    return np.linalg.norm(found[:, :2] - truth[:, :2], axis=1), np.degrees(np.abs(turn))
