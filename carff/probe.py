"""Density probing: which actors stand where in the scene that a latent describes (CARFF 3.2 (a), appendix C).

Candidates are the actor boxes of the data set. A box is crossed by vertical lines of points; a line's optical
thickness is sum sigma dz, and a box's *score* is the mean over its lines of 1 - exp(-gain thickness), a number in
[0, 1] that no single line dominates. With a gain of 1 it is the opacity. Opacity is near 1 with and without the actor
where fog fills the empty box (colours cannot tell a road from fog of its own colour above it); a gain below 1 keeps the
two apart.

Gains and scores are calibrated per candidate on latents of known states: `threshold` lies between the scores with and
without the actor, `width` is the room between them. The state whose set of occupied boxes fits best is the answer,
unless it fits too badly: then the answer is *unknown* (-1). An absent actor is a state like any other: all of its boxes
are empty.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from carff.states import ActorBox
from hashnerf.errors import UserError
from hashnerf.low_precision import without_autocast

UNKNOWN = -1
SMALLEST_WIDTH = 0.2  # a gap of a few per cent of opacity is noise of the field: its vote must stay weak
THINNEST = 1e-6
DensityFn = Callable[[Float[Tensor, "points 3"], Float[Tensor, "latents d"]], Float[Tensor, "latents points"]]


@dataclass(frozen=True)
class ProbeConfig:
    """How densely the candidate boxes are probed, and when the answer is `unknown`."""

    columns: tuple[int, int] = (6, 4)
    """Vertical lines along the length and the width of a box."""
    levels: int = 12
    """Points on each vertical line."""
    margin: float = 0.12
    """Share of the box's size left out at each side, so that the ground and neighbours do not count."""
    min_confidence: float = 0.6
    """Posterior probability under which the state is called unknown."""

    def __post_init__(self):
        if min(*self.columns, self.levels) < 1 or not 0 <= self.margin < 0.5:
            raise UserError("probe: columns and levels must be at least 1 and margin in [0, 0.5)")
        if not 0 <= self.min_confidence <= 1:
            raise UserError(f"probe.min_confidence is {self.min_confidence}; give a probability from 0 to 1")


@dataclass(frozen=True)
class Candidates:
    """Distinct actor boxes, and which of them are occupied in each state."""

    points: Float[Tensor, "boxes lines levels 3"]
    spacing: Float[Tensor, " boxes"]
    """Distance between the points of a line, metres."""
    names: tuple[str, ...]
    occupied: Bool[Tensor, "states boxes"]

    @property
    def same(self) -> Bool[Tensor, "states states"]:
        """Which states occupy the same boxes: to the probe they are one."""
        return (self.occupied[:, None] == self.occupied[None]).all(dim=-1)


@dataclass(frozen=True)
class Probe:
    """Calibrated candidates."""

    candidates: Candidates
    gain: Float[Tensor, " boxes"]
    threshold: Float[Tensor, " boxes"]
    width: Float[Tensor, " boxes"]
    min_confidence: float

    def scores(self, latents: Float[Tensor, "n d"], density_fn: DensityFn) -> Float[Tensor, "n boxes"]:
        """Returns every candidate's score for every latent."""
        return line_scores(box_thickness(self.candidates, latents, density_fn), self.gain)

    @without_autocast
    def state_posterior(self, scores: Float[Tensor, "n boxes"]) -> Float[Tensor, "n states"]:
        """Returns the probability of each state given the scores, states equally likely beforehand."""
        # A logistic in the calibrated score: 4 widths from one end of the gap to the other.
        logit = 4.0 * (scores - self.threshold) / self.width
        log_on, log_off = torch.nn.functional.logsigmoid(logit), torch.nn.functional.logsigmoid(-logit)
        occupied = self.candidates.occupied.float()
        fit = log_on @ occupied.T + log_off @ (1 - occupied).T
        return torch.softmax(fit, dim=-1)

    def classify(self, scores: Float[Tensor, "n boxes"]) -> Int[Tensor, " n"]:
        """Returns the state of each row of scores, or UNKNOWN; equal states answer with the first of them."""
        return self.agreed(scores, self.candidates.same.float().argmax(dim=1))

    @without_autocast
    def agreed(self, scores: Float[Tensor, "n boxes"], label: Int[Tensor, " states"]) -> Int[Tensor, " n"]:
        """Returns the label (0, 1, ...) that the states which fit each row of scores agree on, or UNKNOWN.

        It may be certain where the state is not: two states that differ only in where the ego's own body stands agree
        about the hazard and the branch.
        """
        posterior = self.state_posterior(scores)
        pooled = posterior @ torch.nn.functional.one_hot(label).to(posterior)
        return torch.where(pooled.amax(dim=-1) >= self.min_confidence, pooled.argmax(dim=-1), UNKNOWN)


def build_candidates(states: list[list[ActorBox]], config: ProbeConfig) -> Candidates:
    """Collects the distinct boxes of all states; raises UserError when the data set names none."""
    boxes: list[ActorBox] = []
    rows: list[list[int]] = []
    for actors in states:
        row = []
        for box in actors:
            match = [i for i, known in enumerate(boxes) if known == box]
            if not match:
                boxes.append(box)
            row.append(match[0] if match else len(boxes) - 1)
        rows.append(row)
    if not boxes:
        raise UserError("the data set names no actor boxes: add `actors` to transforms.json to probe, plan or evaluate")
    occupied = torch.zeros(len(states), len(boxes), dtype=torch.bool)
    for state, row in enumerate(rows):
        occupied[state, row] = True
    points = torch.stack([box_points(box, config) for box in boxes])
    spacing = torch.tensor([box.size[2] * (1 - 2 * config.margin) / config.levels for box in boxes])
    return Candidates(points, spacing, tuple(box.name for box in boxes), occupied)


def box_points(box: ActorBox, config: ProbeConfig) -> Float[Tensor, "lines levels 3"]:
    """Returns points on vertical lines through an oriented box, world metres."""

    def centres(count: int) -> Tensor:
        return ((torch.arange(count) + 0.5) / count - 0.5) * (1 - 2 * config.margin)

    along, across = centres(config.columns[0]) * box.size[0], centres(config.columns[1]) * box.size[1]
    up = centres(config.levels) * box.size[2]
    x, y, z = torch.meshgrid(along, across, up, indexing="ij")
    cos, sin = torch.cos(torch.tensor(box.yaw)), torch.sin(torch.tensor(box.yaw))
    points = torch.stack([cos * x - sin * y, sin * x + cos * y, z], dim=-1) + torch.tensor(box.center)
    return points.flatten(0, 1)


def box_thickness(
    candidates: Candidates, latents: Float[Tensor, "n d"], density_fn: DensityFn
) -> Float[Tensor, "n boxes lines"]:
    """Returns the optical thickness of every line of every candidate box for every latent."""
    shape = candidates.points.shape[:3]
    density = density_fn(candidates.points.reshape(-1, 3), latents).reshape(len(latents), *shape)
    return density.sum(dim=-1) * candidates.spacing[:, None]


def line_scores(thickness: Float[Tensor, "n boxes lines"], gain: Float[Tensor, " boxes"]) -> Float[Tensor, "n boxes"]:
    """Returns the mean over the lines of every box of 1 - exp(-gain thickness)."""
    return -torch.expm1(-thickness * gain[:, None]).mean(dim=-1)


def calibrate(
    candidates: Candidates,
    thickness: Float[Tensor, "n boxes lines"],
    state: Int[Tensor, " n"],
    min_confidence: float,
) -> Probe:
    """Sets each candidate's gain and threshold from lines through scenes of known states.

    The gap is measured between the 10 % quantile of the occupied boxes and the 90 % quantile of the empty ones. The
    gain makes the geometric mean of these two thicknesses 1, where 1 - exp(-x) separates best, but is at most 1: a
    faint ghost is still mostly air. The threshold lies half-way between the scores. A candidate whose two sides overlap
    gets a wide, and therefore weak, vote.

    Raises UserError for a thickness that is not finite.
    """
    if not thickness.isfinite().all():
        raise UserError("the field's density is not finite: train it again with a lower nerf.fit.learning_rate")
    occupied = candidates.occupied[state]
    mean = thickness.mean(dim=-1)
    ends = [_gap(mean[:, box], occupied[:, box]) for box in range(mean.shape[1])]
    middle = torch.tensor([math.sqrt(max(low, THINNEST) * max(high, THINNEST)) for low, high in ends])
    gain = (1 / middle).clamp(max=1.0)
    scores = line_scores(thickness, gain)
    threshold, width = [], []
    for box in range(scores.shape[1]):
        low, high = _gap(scores[:, box], occupied[:, box])
        threshold.append((low + high) / 2)
        width.append(max(high - low, SMALLEST_WIDTH) if high > low else 1.0)
    return Probe(candidates, gain, torch.tensor(threshold), torch.tensor(width), min_confidence)


def _gap(values: Float[Tensor, " n"], on: Bool[Tensor, " n"]) -> tuple[float, float]:
    """The upper end of a box's values without the actor (0 if never seen) and the lower end with it (1 if never)."""
    low = float(values[~on].quantile(0.9)) if bool((~on).any()) else 0.0
    high = float(values[on].quantile(0.1)) if bool(on.any()) else 1.0
    return low, high
