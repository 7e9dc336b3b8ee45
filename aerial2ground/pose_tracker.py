"""Several ideas of where the car is, each followed by a pose filter; the one that the network agrees with most is told.

A network errs in bursts: for seconds it sees another corner of the town. A single filter that starts in such a burst
refuses what is right, and one that restarts after refusals may restart wrong. Here every pose that no idea can explain
begins an idea of its own, and agreement decides: the truth agrees with itself along the drive, errors do not. A car
that was carried elsewhere is found once the old idea has faded: after at most 0.7 `memory` and three pictures.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from aerial2ground.pose_filter import PoseFilter, PoseFilterConfig
from worlds.boxes import wrap_angle
from worlds.inertial import Readings


@dataclass
class Hypothesis:
    """One idea, and how much the network has spoken for it of late."""

    filter: PoseFilter
    agreement: float


class PoseTracker:
    """One drive, as `PoseFilter`, from several starts."""

    def __init__(self, config: PoseFilterConfig):
        self.config = config
        self.hypotheses: list[Hypothesis] = []

    @property
    def started(self) -> bool:
        """Whether there is any idea."""
        return bool(self.hypotheses)

    @property
    def pose(self) -> Float[np.ndarray, " 3"]:
        """(x, y, yaw) of the idea with most agreement; raises ValueError before the first usable pose."""
        if not self.hypotheses:
            raise ValueError("the pose is not known; give a finite pose to update first")
        return self.hypotheses[0].filter.pose

    def predict(self, yaw_rate: float, acceleration: float, dt: float) -> None:
        """Moves all ideas on; see `PoseFilter.predict`. Lost ones are forgotten."""
        for one in self.hypotheses:
            one.filter.predict(yaw_rate, acceleration, dt)
        self.hypotheses = [one for one in self.hypotheses if one.filter.started]

    def update(self, pose: Float[np.ndarray, " 3"], deviation: Float[np.ndarray, " 2"] | None = None) -> bool:
        """Takes in the network's pose, see `PoseFilter.update`; returns whether any idea could use it.

        What none can use begins a new one.
        """
        used = False
        for one in self.hypotheses:
            said = one.filter.evidence(pose, deviation)
            agreed = one.filter.update(pose, deviation)
            one.agreement = one.agreement * (1 - 1 / self.config.memory) + (said if agreed else 0.0)
            used |= agreed
        if not used:
            fresh = Hypothesis(PoseFilter(self.config), 0.0)
            if fresh.filter.update(pose, deviation):
                self.hypotheses.append(fresh)
        self._prune()
        return used

    def _prune(self) -> None:
        """Most agreement first; of two that have met the one with less is dropped, and what is too many."""
        kept: list[Hypothesis] = []
        for one in sorted(self.hypotheses, key=lambda one: -one.agreement):
            if not any(self._same(one.filter.pose, other.filter.pose) for other in kept):
                kept.append(one)
        self.hypotheses = kept[: int(self.config.hypotheses)]

    def _same(self, pose: np.ndarray, other: np.ndarray) -> bool:
        near = float(np.linalg.norm(pose[:2] - other[:2])) < self.config.position_std
        return near and abs(wrap_angle(float(pose[2] - other[2]))) < math.radians(self.config.yaw_std)


def filtered_poses(
    readings: Readings,
    picture_times: Float[np.ndarray, " k"],
    picture_poses: Float[np.ndarray, "k 3"],
    config: PoseFilterConfig,
    deviations: Float[np.ndarray, "k 2"] | None = None,
) -> Float[np.ndarray, "k 3"]:
    """Returns the pose at every picture from all readings and network poses up to it, none later.

    `deviations` are the network's own, see `PoseFilter.update`.
    Rows are NaN while the pose is not known: until the network's first finite pose. Raises ValueError for times that
    are not finite or fall; pictures may share a time, readings may not.
    """
    times = readings.time
    if not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
        raise ValueError("the times of the readings must be finite and rise")
    if not (np.isfinite(picture_times).all() and (np.diff(picture_times) >= 0).all()):
        raise ValueError("the times of the pictures must be finite and must not fall")
    fused, filtered = PoseTracker(config), np.full((len(picture_times), 3), np.nan)
    clock = float(picture_times[0]) if len(picture_times) else 0.0
    following = int(np.searchsorted(times, clock, side="right"))
    for picture, moment in enumerate(picture_times):
        while following < len(times) and times[following] <= moment:
            rate, push = readings.yaw_rate[following], readings.acceleration[following, 0]
            fused.predict(float(rate), float(push), float(times[following]) - clock)
            clock = float(times[following])
            following += 1
        if moment > clock:  # the reading that covers this has not come yet: the last one is held
            fresh = following > 0 and moment - times[following - 1] <= config.longest_reading
            rate = float(readings.yaw_rate[following - 1]) if fresh else math.nan
            push = float(readings.acceleration[following - 1, 0]) if fresh else math.nan
            fused.predict(rate, push, float(moment) - clock)
            clock = float(moment)
        fused.update(picture_poses[picture], None if deviations is None else deviations[picture])
        if fused.started:
            filtered[picture] = fused.pose
    return filtered
