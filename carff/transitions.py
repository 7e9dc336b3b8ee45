"""Training pairs of the forecast: a view's belief now -> belief of the next state seen by a nearby camera (CARFF B.2).

An occluded view looks the same in several branches; its successor, seen by a neighbour that is not blocked, does not.
Such pairs teach the mixture that one picture may have several futures. Cameras are neighbours by geometry, never by
their number.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from carff.beliefs import Belief, require_latents, sample_beliefs, view_distinctness
from carff.mixtures import choose_component
from hashnerf.errors import UserError


@dataclass(frozen=True)
class TransitionConfig:
    """Which pairs of views the forecast learns from."""

    neighbours: int = 8
    """Cameras nearest to the source camera, itself included, from which the next state may be seen (paper: 8)."""
    clear_neighbours: float = 8.0
    """The neighbourhood grows beyond `neighbours` until the distinctness of its cameras adds up to this."""
    distinctness_floor: float = 0.001
    """Added to each camera's distinctness, so that no camera is left out for good."""
    noise_low: float = 0.001
    """Smallest standard deviation of the noise added to the source belief (paper: 0.001)."""
    noise_high: float = 0.01
    """Largest standard deviation of the noise added to the source belief (paper: 0.01)."""
    samples: int = 16
    """Latents drawn from each target belief per step."""

    def __post_init__(self):
        if self.neighbours < 1:
            raise UserError(f"transitions.neighbours is {self.neighbours}; give at least 1 (the camera itself)")
        if self.clear_neighbours < 0:
            raise UserError(f"transitions.clear_neighbours is {self.clear_neighbours}; give 0 or more")
        if self.samples < 1:
            raise UserError(f"transitions.samples is {self.samples}; give at least 1")
        if not 0 <= self.noise_low <= self.noise_high:
            raise UserError(
                f"transitions.noise_low is {self.noise_low} and noise_high {self.noise_high}; give 0 <= low <= high"
            )
        if self.distinctness_floor < 0:
            raise UserError(f"transitions.distinctness_floor is {self.distinctness_floor}; give 0 or more")


@dataclass(frozen=True)
class ViewBeliefs:
    """The encoder's belief about every view; `valid` is False where a state has no picture from a camera."""

    means: Float[Tensor, "states cameras d"]
    logvars: Float[Tensor, "states cameras d"]
    valid: Bool[Tensor, "states cameras"]

    def at(self, state: Int[Tensor, " n"], camera: Int[Tensor, " n"]) -> Belief:
        """Returns the beliefs of n views."""
        return Belief(self.means[state, camera], self.logvars[state, camera])


@dataclass(frozen=True)
class TransitionBatch:
    """Beliefs now, the beliefs they turn into, and latents drawn from the latter."""

    source: Belief
    target: Belief
    samples: Float[Tensor, "n samples d"]


def camera_distances(poses: Float[Tensor, "cameras 4 4"]) -> Float[Tensor, "cameras cameras"]:
    """Returns how far apart cameras are: metres between them, plus the angle between their axes times the rig's radius.

    The radius (root mean square distance from the rig's centre) makes both terms alike for cameras around a scene and
    leaves the order of neighbours unchanged when the world is scaled.
    """
    poses = poses.double()
    position, axis = poses[:, :3, 3], -poses[:, :3, 2]
    radius = (position - position.mean(dim=0)).square().sum(dim=1).mean().sqrt()
    cross = torch.linalg.cross(axis[:, None], axis[None, :], dim=-1).norm(dim=-1)
    angle = torch.atan2(cross, axis @ axis.T)  # exact near 0 and pi, where acos is not
    # A rig that turns on the spot has no radius; the angle alone then orders its cameras.
    scale = torch.where(radius > 0, radius, 1.0)
    return torch.linalg.vector_norm(position[:, None] - position[None, :], dim=-1) + scale * angle


def camera_neighbours(
    poses: Float[Tensor, "cameras 4 4"], usable: Bool[Tensor, " cameras"] | None = None
) -> Int[Tensor, "cameras cameras"]:
    """Returns for each camera itself and then all others, nearest first, ties by number.

    Cameras that are not `usable` (held out) come last, so that they take no usable camera's place.
    """
    distances = camera_distances(poses)
    distances.fill_diagonal_(-1.0)  # a second camera at the same pose must not displace the camera itself
    if usable is not None:
        distances[:, ~usable] = torch.inf
    return distances.argsort(dim=1, stable=True)


class TransitionSampler:
    """Draws training pairs; a batch depends on the seed and the step alone, so a resumed run sees the same ones."""

    def __init__(
        self,
        beliefs: ViewBeliefs,
        successor: Int[Tensor, " states"],
        poses: Float[Tensor, "cameras 4 4"],
        config: TransitionConfig,
        seed: int,
        weight: Float[Tensor, " states"] | None = None,
    ):
        """`successor` is the next state of each state, or -1 where the branch ends. Raises UserError without pairs.

        `weight` says how often views of each state are drawn, in proportion; all alike without it.
        """
        require_latents(beliefs.means[beliefs.valid], "means of the encoded views")
        require_latents(beliefs.logvars[beliefs.valid], "log-variances of the encoded views")
        self.beliefs, self.successor, self.config, self.seed = beliefs, successor, config, seed
        self.neighbours = camera_neighbours(poses, beliefs.valid.any(dim=0))
        distinctness = view_distinctness(beliefs.means, beliefs.logvars, beliefs.valid)
        self.sources, self.log_probability = _pairs(beliefs.valid, distinctness, successor, self.neighbours, config)
        self.weight = (torch.ones(len(successor)) if weight is None else weight)[self.sources[:, 0]]

    def batch(self, step: int, size: int) -> TransitionBatch:
        """Returns the `size` pairs of a training step, with noise on the source beliefs."""
        generator = torch.Generator().manual_seed((self.seed * 1_000_003 + step) % 2**63)
        row = torch.multinomial(self.weight, size, replacement=True, generator=generator)
        source, target = self._beliefs(row, generator)
        low, high = self.config.noise_low, self.config.noise_high
        sigma = low + (high - low) * torch.rand(size, 1, generator=generator)
        noise = sigma * torch.randn(2, size, source.mean.shape[1], generator=generator)
        noisy = Belief(source.mean + noise[0], source.logvar + noise[1])
        return TransitionBatch(noisy, target, sample_beliefs(target, self.config.samples, generator))

    def all_sources(self, generator: torch.Generator) -> TransitionBatch:
        """Returns one pair for every source view, without noise on the source."""
        source, target = self._beliefs(torch.arange(len(self.sources)), generator)
        return TransitionBatch(source, target, sample_beliefs(target, self.config.samples, generator))

    def _beliefs(self, row: Int[Tensor, " n"], generator: torch.Generator) -> tuple[Belief, Belief]:
        state, camera = self.sources[row].unbind(dim=1)
        log_probability = self.log_probability[row]
        uniform = torch.rand(len(row), 1, log_probability.shape[1], generator=generator)
        chosen = choose_component(log_probability, uniform)[:, 0]
        source = self.beliefs.at(state, camera)
        return source, self.beliefs.at(self.successor[state], self.neighbours[camera, chosen])


def _pairs(
    valid: Bool[Tensor, "states cameras"],
    distinctness: Float[Tensor, "states cameras"],
    successor: Int[Tensor, " states"],
    neighbours: Int[Tensor, "cameras cameras"],
    config: TransitionConfig,
) -> tuple[Int[Tensor, "sources 2"], Float[Tensor, "sources cameras"]]:
    """Returns (state, camera) of every usable source view and the log-probability of each neighbour as its target."""
    usable = valid & (successor >= 0)[:, None]
    sources = usable.nonzero()
    after = successor[sources[:, 0]][:, None]
    around = neighbours[sources[:, 1]]
    clear = distinctness[after, around]
    # Where everything near by is occluded too, only cameras further away can say what the next state may be.
    near = torch.arange(len(neighbours)) < config.neighbours
    seen = valid[after, around] & (near | (clear.cumsum(dim=1) - clear < config.clear_neighbours))
    weight = (clear + config.distinctness_floor) * seen
    weight = torch.where(weight.sum(dim=1, keepdim=True) > 0, weight, seen.to(weight.dtype))
    keep = seen.any(dim=1)
    if not keep.any():
        raise UserError("no view has a next state seen by a neighbouring camera: a forecast needs two steps or more")
    weight = weight[keep]
    return sources[keep], torch.log(weight / weight.sum(dim=1, keepdim=True))
