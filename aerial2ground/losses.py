"""What the networks are trained by: the paper's L1 and L2 (Alg. 2), or a distance and how sure the network is of it.

`laplace` takes numbers in pairs (x and y; sine and cosine). Their answer is learned by its distance, a width beside it
by the likelihood of that distance under a density with heavy tails, as in "What uncertainties do we need in Bayesian
deep learning for computer vision?" (Kendall and Gal, 2017). Learned by that likelihood too, the answer of the pair that
is learned first pulls by one over its width: yaw, soon known, leaves the place unlearned.
"""

import math
from collections.abc import Callable
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

LossName = Literal["l1", "l2", "laplace"]
WIDTHS = 0.1
"""Weight of what teaches the widths; they share the network with the answers, which 1 makes worse."""
WIDEST = 6.0
"""Bound of the logarithm of a width, in units of the targets, either way; widths near it hardly move any more."""
SMALLEST = 1e-4
"""Distances below this are as good as none; keeps the slope at 0 finite."""


def loss_of(name: LossName) -> Callable[[Tensor, Tensor], Tensor]:
    """Returns the loss of that name: answers and targets in, one number out."""
    losses = {"l1": torch.nn.functional.l1_loss, "l2": torch.nn.functional.mse_loss, "laplace": laplace_loss}
    return losses[name]


def answers_of(name: LossName, targets: int) -> int:
    """How many numbers a network tells that has this many targets: `laplace` adds a width to every pair."""
    return targets + targets // 2 if name == "laplace" else targets


def laplace_loss(answers: Float[Tensor, "n answers"], targets: Float[Tensor, "n targets"]) -> Float[Tensor, ""]:
    """Mean over pictures of r + WIDTHS (r / b + 2 log b), summed over pairs; r is the distance of a pair, b its width.

    What follows WIDTHS is -log of exp(-r / b) / (2 pi b^2), the density of a pair, but for a constant; it teaches the
    widths alone.
    """
    count = targets.shape[1]
    apart = (answers[:, :count] - targets).view(len(targets), -1, 2)
    distance = (apart.square().sum(dim=2) + SMALLEST**2).sqrt()
    logs = log_widths(answers[:, count:])
    return (distance + WIDTHS * (distance.detach() * (-logs).exp() + 2 * logs)).sum(dim=1).mean()


def log_widths(raw: Float[Tensor, "n pairs"]) -> Float[Tensor, "n pairs"]:
    """Returns logarithms of widths within their bounds; near 0 as they are."""
    return WIDEST * torch.tanh(raw / WIDEST)


def deviations(raw: Float[Tensor, "n pairs"]) -> Float[Tensor, "n pairs"]:
    """Returns the standard deviation of each number of a pair: sqrt(3) b, as the mean of r^2 is 6 b^2."""
    return math.sqrt(3) * log_widths(raw).exp()
