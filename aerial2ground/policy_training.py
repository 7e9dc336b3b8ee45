"""Training the two networks (Alg. 2): steering by L1, pose by L2 or Laplace; Adam 1e-2, 100 epochs.

Pictures are augmented against what differs between the reconstruction and the world: exposure, white balance, shadows,
noise, rows, and the sky, which no drone sees. Poses are standardised by the training set; yaw is sine and cosine.
"""

import math
from dataclasses import dataclass, field

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from aerial2ground.losses import LossName, answers_of, loss_of
from aerial2ground.networks import NetworkConfig, PictureNetwork
from hashnerf.errors import UserError
from hashnerf.finite_steps import FiniteSteps
from hashnerf.low_precision import without_autocast


@dataclass(frozen=True)
class AugmentationConfig:
    """Random changes of training pictures; 0 switches each off."""

    exposure: float = 0.3
    """Largest change of brightness, as a share."""
    white_balance: float = 0.1
    """Largest change of a colour channel, as a share."""
    gamma: float = 0.2
    """Largest change of the exponent, as a share."""
    noise: float = 0.03
    """Largest standard deviation of pixel noise."""
    shadow: float = 0.3
    """Largest darkening of a random half of the picture, as a share."""
    row_jitter: float = 0.15
    """Share of the rows that show what the row above them shows: which lines of marks a small picture catches near the
    horizon is a matter of a millimetre of height."""
    sky: bool = True
    """Give every picture another sky: a drone that looks down cannot know it."""

    def __post_init__(self):
        for key in ("exposure", "white_balance", "gamma", "noise", "shadow", "row_jitter"):
            if not 0 <= getattr(self, key) < 1:
                raise UserError(f"augmentation.{key} is {getattr(self, key)}; give a number from 0 and below 1")


@dataclass(frozen=True)
class TaskConfig:
    """A network and its training."""

    network: NetworkConfig = field(default_factory=NetworkConfig)
    """Size of the network."""
    augmentation: AugmentationConfig = field(default_factory=AugmentationConfig)
    """Changes of training pictures."""
    epochs: int = 100
    """Passes over the pictures (paper: 100)."""
    batch_size: int = 64
    """Pictures per step."""
    lr: float = 0.01
    """First step of Adam (paper: 0.01); it falls to zero along a cosine."""
    weight_decay: float = 0.0
    """Share of every weight that a step takes away, in units of the step (AdamW); 0 is Adam (paper)."""

    def __post_init__(self):
        for key, least in (("epochs", 1), ("batch_size", 2)):  # batch normalisation needs two pictures
            if getattr(self, key) < least:
                raise UserError(f"task.{key} is {getattr(self, key)}; give at least {least}")
        if not 0 < self.lr < math.inf:
            raise UserError(f"task.lr is {self.lr}; give a positive number")
        if not 0 <= self.weight_decay * self.lr < 1:
            raise UserError(f"task.weight_decay is {self.weight_decay}; give 0 or more, and less than 1 / lr")


def augmented(
    pictures: Float[Tensor, "n c h w"],
    config: AugmentationConfig,
    generator: torch.Generator,
    sky: Bool[Tensor, "n h w"] | None = None,
) -> Float[Tensor, "n c h w"]:
    """Returns changed pictures in [0, 1]; of a depth channel only rows change. `sky` says where nothing is."""
    n, _, height, width = pictures.shape
    if config.row_jitter:
        rows = jittered_rows(n, height, config.row_jitter, generator)
        pictures = pictures.gather(2, rows[:, None, :, None].expand(pictures.shape))
        sky = None if sky is None else sky.gather(1, rows[:, :, None].expand(sky.shape))
    colour, rest = pictures[:, :3], pictures[:, 3:]
    if sky is not None and config.sky:
        colour = torch.where(sky[:, None], random_skies(n, height, generator)[..., None], colour)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=generator) * 2 - 1

    # in place, and a power as the exponential of a logarithm: this is a third of the time of a training step
    colour = colour.clamp(min=1e-4).log_().mul_(1 + config.gamma * uniform(n, 1, 1, 1)).exp_()
    colour.mul_((1 + config.exposure * uniform(n, 1, 1, 1)) * (1 + config.white_balance * uniform(n, 3, 1, 1)))
    # a straight edge through the picture, one side of it darker
    angle = math.pi * uniform(n, 1, 1)
    rows = torch.linspace(-1, 1, height)[None, :, None]
    columns = torch.linspace(-1, 1, width)[None, None, :]
    dark = (angle.cos() * columns + angle.sin() * rows > uniform(n, 1, 1))[:, None]
    colour.mul_(1 - config.shadow * torch.rand(n, 1, 1, 1, generator=generator) * dark)
    sigma = config.noise * torch.rand(n, 1, 1, 1, generator=generator)
    colour.addcmul_(sigma, torch.randn(colour.shape, generator=generator)).clamp_(0, 1)
    return torch.cat([colour, rest], dim=1) if rest.shape[1] else colour


def jittered_rows(count: int, height: int, share: float, generator: torch.Generator) -> Int[Tensor, "count height"]:
    """Returns which row each row of a picture shows: its own, or with probability `share` the one above."""
    up = torch.rand(count, height, generator=generator) < share
    return (torch.arange(height) - up.long()).clamp(min=0)


def random_skies(count: int, height: int, generator: torch.Generator) -> Float[Tensor, "count 3 height"]:
    """Returns colours of skies from the upper edge of a picture down: grey to blue, darker or paler upwards."""

    def uniform(low: float, high: float) -> Tensor:
        return low + (high - low) * torch.rand(count, 1, 1, generator=generator)

    blue = uniform(0.0, 0.5) * torch.tensor([1.0, 0.5, 0.0])[None, :, None]
    top, bottom = uniform(0.35, 1.0), uniform(0.5, 1.0)
    share = torch.linspace(0, 1, height)[None, None]
    return (top + (bottom - top) * share) * (1 - blue * (1 - 0.7 * share))


@without_autocast
def train_network(
    config: TaskConfig,
    pictures: UInt8[Tensor, "n h w c"],
    targets: Float[Tensor, "n outputs"],
    loss: LossName,
    seed: int,
    sky: Bool[Tensor, "n h w"] | None = None,
) -> PictureNetwork:
    """Trains a network on pictures (0..255, a fourth channel is depth) and targets.

    `sky` says where nothing is in the pictures, as far as that is known.
    """
    if len(pictures) < 2:
        raise UserError(f"{len(pictures)} training pictures are too few: batch normalisation needs two or more")
    torch.manual_seed(seed)
    network = PictureNetwork(config.network, pictures.shape[1], pictures.shape[2], answers_of(loss, targets.shape[1]))
    generator = torch.Generator().manual_seed(seed)
    optimizer = torch.optim.AdamW(network.parameters(), lr=config.lr, weight_decay=config.weight_decay)
    batches = max(len(pictures) // config.batch_size, 1)
    error, guard = loss_of(loss), FiniteSteps()
    steps = config.epochs * batches
    for epoch in range(config.epochs):
        order = torch.randperm(len(pictures), generator=generator)
        for number, rows in enumerate(order.tensor_split(batches)):
            share = (epoch * batches + number) / steps
            optimizer.param_groups[0]["lr"] = config.lr * 0.5 * (1 + math.cos(math.pi * share))
            above = None if sky is None else sky[rows]
            seen = augmented(as_input(pictures[rows]), config.augmentation, generator, above)
            optimizer.zero_grad(set_to_none=True)
            wrong = error(network(seen.contiguous(memory_format=torch.channels_last)), targets[rows])
            wrong.backward()
            slope = torch.nn.utils.get_total_norm([p.grad for p in network.parameters() if p.grad is not None])
            if guard.accepts(epoch * batches + number, {"loss": wrong.detach(), "gradient": slope}):
                optimizer.step()
    # steps are skipped to the end where a network no longer answers with numbers; normalisation has learnt them all
    if guard.in_a_row or not all(bool(value.isfinite().all()) for value in network.state_dict().values()):
        raise UserError(
            f"training of a network broke down, its weights or answers are not finite; lower task.lr ({config.lr})"
        )
    return network.eval()


def as_input(pictures: UInt8[Tensor, "n h w c"]) -> Float[Tensor, "n c h w"]:
    """Returns stored pictures as the network reads them."""
    return pictures.permute(0, 3, 1, 2).float() / 255
