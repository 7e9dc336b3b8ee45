"""Camera rigs: poses along a lane, on a ring around the scene, and straight down. Square images, angles in degrees."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from hashnerf.cameras import Cameras, look_at
from worlds.boxes import Pose
from worlds.routes import Route

BASE_SIZE = 128
"""Rigs are made for images of this many pixels a side; `Cameras.scaled` changes it exactly."""
CLEARANCE = 0.42
"""No camera comes closer than this to an ego body, metres."""
BESIDE = 4
"""Cameras that pass each ego body on its left."""

CameraPose = Float[Tensor, "4 4"]


@dataclass(frozen=True)
class Mount:
    """A camera on the ego's lane: it looks `yaw` to the left, and `pan` more as it comes to the stop line."""

    height: float
    """Metres above the road."""
    pitch: float
    """Degrees above the horizon."""
    yaw: float
    """Degrees to the left of the heading."""
    pan: float
    """Degrees that it turns further left between `pan_from` and `pan_to`."""
    pan_from: float
    """Arc length of the camera where it starts to turn, metres."""
    pan_to: float
    """Arc length of the camera where it has turned, metres."""
    field_of_view: float
    """Degrees across."""

    def pose(self, ground: Pose, s: float, turn: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> CameraPose:
        """The camera above `ground` at arc length `s`; `turn` adds metres up, degrees left, degrees up."""
        share = min(max((s - self.pan_from) / (self.pan_to - self.pan_from), 0.0), 1.0)
        yaw = ground.yaw + math.radians(self.yaw + self.pan * share + turn[1])
        pitch = math.radians(self.pitch + turn[2])
        eye = (ground.x, ground.y, ground.z + self.height + turn[0])
        return heading_pose(eye, yaw, pitch)


def heading_pose(eye: Sequence[float], yaw: float, pitch: float) -> CameraPose:
    """A camera at `eye` that looks along `yaw`, `pitch` above the horizon (radians), upright."""
    flat = math.cos(pitch)
    target = (eye[0] + flat * math.cos(yaw), eye[1] + flat * math.sin(yaw), eye[2] + math.sin(pitch))
    return look_at(tuple(eye), target)


def pinholes(poses: Sequence[CameraPose], fields_of_view: Sequence[float]) -> Cameras:
    """Square pinhole cameras of BASE_SIZE pixels, one field of view each."""
    focal = [0.5 * BASE_SIZE / math.tan(math.radians(angle) / 2) for angle in fields_of_view]
    middle = torch.full((len(poses), 2), BASE_SIZE / 2)
    pairs = torch.tensor(focal, dtype=torch.float32)[:, None].expand(-1, 2).contiguous()
    return Cameras(torch.stack(list(poses)), pairs, middle, torch.zeros(len(poses), 4), BASE_SIZE, BASE_SIZE)


def _spread(low: float, high: float, count: int, rng: np.random.Generator) -> list[float]:
    """`count` increasing numbers spread over an interval with jitter."""
    return [low + (high - low) * (i + 0.5 + float(rng.uniform(-0.3, 0.3))) / count for i in range(count)]


def _shares(lengths: Sequence[float], total: int) -> list[int]:
    """Splits `total` cameras over gaps by the square root of their length, so that short gaps are not starved."""
    weights = np.sqrt(np.array(lengths))
    edges = np.rint(np.cumsum(weights) / weights.sum() * total).astype(int)
    return np.diff(np.concatenate([[0], edges])).tolist()


def lane_poses(
    route: Route, bodies: Sequence[float], body: tuple[float, float, float], span: tuple[float, float],
    count: int, mount: Mount, rng: np.random.Generator,
) -> list[CameraPose]:  # fmt: skip
    """Cameras along the ego's lane over the arc lengths `span`, in order, clear of ego bodies centred at `bodies`.

    Most stand in the gaps between the bodies, as a camera at the front bumper does; BESIDE of them pass each body.
    """
    half = body[0] / 2 + CLEARANCE
    blocked = [(s - half, s + half) for s in sorted(set(bodies))]
    edges = [span[0], *(edge for pair in blocked for edge in pair), span[1]]
    gaps = list(zip(edges[0::2], edges[1::2]))
    counts = _shares([high - low for low, high in gaps], count - BESIDE * len(blocked))
    places: list[tuple[float, float]] = []
    for number, ((low, high), cameras) in enumerate(zip(gaps, counts)):
        places += [(s, float(rng.uniform(-0.3, 0.3))) for s in _spread(low, high, cameras, rng)]
        if number < len(blocked):
            side = body[1] / 2 + CLEARANCE
            places += [(s, side + float(rng.uniform(0.02, 0.2))) for s in _spread(*blocked[number], BESIDE, rng)]
    poses = []
    for s, left in places:
        at = route.pose(s)
        ground = Pose(at.x - left * math.sin(at.yaw), at.y + left * math.cos(at.yaw), at.z, at.yaw)
        turn = (float(rng.uniform(-0.06, 0.06)), float(rng.uniform(-5.0, 5.0)), float(rng.uniform(-1.5, 1.5)))
        poses.append(mount.pose(ground, s, turn))
    return poses


def ring_poses(
    count: int, centre: tuple[float, float], target: tuple[float, float, float],
    radius: tuple[float, float], height: tuple[float, float], rng: np.random.Generator,
    arc: tuple[float, float] = (0.0, 360.0),
) -> list[CameraPose]:  # fmt: skip
    """Cameras around `centre` in order of azimuth (degrees), jittered in azimuth, radius, height and aim (metres)."""
    poses = []
    for azimuth in _spread(math.radians(arc[0]), math.radians(arc[1]), count, rng):
        distance, level = float(rng.uniform(*radius)), float(rng.uniform(*height))
        eye = (centre[0] + distance * math.cos(azimuth), centre[1] + distance * math.sin(azimuth), level)
        aim = np.array(target) + rng.uniform(-1.0, 1.0, 3) * np.array([1.0, 1.0, 0.3]) * 0.05 * distance
        poses.append(look_at(eye, tuple(aim.tolist())))
    return poses


def interleaved_splits(kinds: Sequence[str], every: int, birds_eye_split: str) -> tuple[str, ...]:
    """Every `every`-th camera of each kind is `test`, never the first or last of its kind; the bird's-eye as asked."""
    splits = []
    for number, kind in enumerate(kinds):
        place, last = number - list(kinds).index(kind), list(kinds).count(kind) - 1
        held_out = place % every == every // 2 and place != last
        splits.append(birds_eye_split if kind == "birds_eye" else "test" if held_out else "train")
    return tuple(splits)
