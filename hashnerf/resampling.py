"""Drawing samples along rays where opacity is expected, from intervals that tile a ray or parts of it.

The importance of an interval is the visible opacity expected in it plus a floor, spread evenly over the ray. A ray's
intervals are laid end to end by importance; that axis is cut into as many equal strata as the ray gets samples.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

FLOOR = 0.5  # opacity added to all occupied intervals of a ray together, so that none is ever left out


@dataclass(frozen=True)
class Samples:
    """Samples of rays, front to back, padded to the longest ray; a padded place has t = dt = 0 and mask False."""

    t: Float[Tensor, "rays samples"]
    dt: Float[Tensor, "rays samples"]
    mask: Bool[Tensor, "rays samples"]

    def places(self) -> tuple[Tensor, Tensor]:
        """Positions of the true samples in the flattened table, and the ray of each."""
        place = self.mask.view(-1).nonzero()[:, 0]
        return place, place // max(self.mask.shape[1], 1)


@dataclass(frozen=True)
class Strata:
    """How a ray's samples are spread over its intervals."""

    start: Float[Tensor, "rays intervals"]
    dt: Float[Tensor, "rays intervals"]
    importance: Float[Tensor, "rays intervals"]
    cumulative: Float[Tensor, "rays intervals"]
    count: Float[Tensor, "rays 1"]
    """Samples of each ray, 0 where there is nothing to sample."""

    @classmethod
    def of(
        cls,
        start: Float[Tensor, "rays intervals"],
        dt: Float[Tensor, "rays intervals"],
        expected: Float[Tensor, "rays intervals"],
        mask: Bool[Tensor, "rays intervals"],
        per_opacity: float,
        most: int,
    ) -> "Strata":
        """Spreads up to `most` samples a ray, `per_opacity` for each opaque interval, over intervals with `mask`."""
        evenly = FLOOR / dt.sum(dim=1, keepdim=True).clamp(min=1e-12)
        importance = torch.addcmul(expected, dt, evenly).mul_(mask)
        cumulative = torch.cumsum(importance, dim=1)
        total = cumulative[:, -1:]
        count = (total * per_opacity + 1).ceil().clamp(max=most) * (total > 0)
        return cls(start, dt, importance, cumulative, count)

    def places(self, further: int = 0) -> Float[Tensor, "rays places"]:
        """Numbers of the strata of each ray, as many as the ray with most of them has, and `further` ones."""
        width = int(self.count.max()) if len(self.count) else 0
        numbers = torch.arange(width + further, device=self.dt.device, dtype=self.dt.dtype)
        return numbers.expand(len(self.dt), width + further)

    def find(
        self, place: Float[Tensor, "rays places"], right: bool
    ) -> tuple[Float[Tensor, "rays places"], Tensor, Tensor]:
        """Where places on the axis of strata lie (m), and length and importance of their intervals.

        On the border of two intervals, between which there may be a gap, `right` says which of them is meant.
        """
        wanted = place / self.count.clamp(min=1) * self.cumulative[:, -1:]
        interval = torch.searchsorted(self.cumulative, wanted, right=right).clamp(max=self.dt.shape[1] - 1)
        mass, length = self.importance.gather(1, interval), self.dt.gather(1, interval)
        inside = (wanted - self.cumulative.gather(1, interval)) / torch.where(mass > 0, mass, 1.0) + 1
        return self.start.gather(1, interval) + inside.clamp(0, 1) * length, length, mass


def uniform(like: Tensor, generator: torch.Generator | None) -> Tensor:
    """Random numbers in [0, 1), or the middle without a generator."""
    if generator is None:
        return torch.full_like(like, 0.5)
    return torch.rand(like.shape, generator=generator, device=like.device, dtype=like.dtype)


def draw_samples(strata: Strata, generator: torch.Generator | None) -> Samples:
    """Draws one sample in each stratum.

    A sample drawn with density p (1/m) among n stands for a length 1/(n p), so every sample has about the same optical
    thickness and the integral along the ray stays right whatever the expectation was.
    """
    place = strata.places()
    kept = place < strata.count
    t, length, mass = strata.find(place + uniform(place, generator), right=True)
    kept &= mass > 0
    dt = length * strata.cumulative[:, -1:] / (strata.count.clamp(min=1) * torch.where(mass > 0, mass, 1.0))
    return Samples(torch.where(kept, t, 0.0), torch.where(kept, dt, 0.0), kept)


def cut_pieces(
    strata: Strata,
) -> tuple[Float[Tensor, "rays pieces"], Float[Tensor, "rays pieces"], Bool[Tensor, "rays pieces"]]:
    """Returns start and length (m) of the pieces that the strata cut a ray into, and which of them there are.

    A piece may run over a gap between intervals: what it holds of the gap is sampled like the rest.
    """
    place = strata.places(1)
    end, _, _ = strata.find(place.minimum(strata.count), right=False)
    # the first end is the beginning of the first interval with any importance, not of the ray
    first = (strata.importance > 0).to(torch.uint8).argmax(dim=1, keepdim=True)
    end[:, :1] = strata.start.gather(1, first)
    return end[:, :-1], end.diff(dim=1).clamp(min=0), place[:, :-1] < strata.count
