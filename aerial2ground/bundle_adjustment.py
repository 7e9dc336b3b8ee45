"""Poses and points that explain where points are seen: a robust bundle adjustment around told poses.

Minimises, over a correction of each pose and the place of each point,

    sum_k s^2 log(1 + |e_k|^2 / s^2) + sum_i |v_i|^2 / position_std^2 + |w_i|^2 / angle_std^2

with e_k the error of a sighting in units of `noise`, s the `scale` from which errors are taken for mistakes (Cauchy),
and (v_i, w_i) how far pose i has moved (m) and turned (rad) from what was told: that also fixes where, how large and
how turned everything is as a whole, which no picture tells. Levenberg-Marquardt; points are eliminated first
(Triggs et al., Bundle Adjustment - A Modern Synthesis, 2000, section 6).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation

NEAREST = 1e-3
"""Metres in front of a camera below which nothing is seen."""
MOST = 1e12
"""Square of an error, in units of `noise`, beyond which it is as good as infinite; what lies behind a camera has it."""
ENOUGH = 1e-5
"""A step that lowers the cost by a smaller share ends the search."""
DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e8


@dataclass(frozen=True)
class Sightings:
    """Points seen by cameras; image points at unit distance without lens, x right and y up, sorted by point."""

    camera: Int[np.ndarray, " k"]
    point: Int[np.ndarray, " k"]
    place: Float[np.ndarray, "k 2"]

    @classmethod
    def none(cls) -> "Sightings":
        """No sightings."""
        return cls(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)))

    @property
    def points(self) -> int:
        """How many points there are."""
        return int(self.point.max()) + 1 if len(self.point) else 0

    def repeated(self, least: int) -> "Sightings":
        """Only points seen at least so often, numbered anew."""
        kept = np.bincount(self.point)[self.point] >= least
        _, number = np.unique(self.point[kept], return_inverse=True)
        order = np.argsort(number, kind="stable")
        return Sightings(self.camera[kept][order], number[order], self.place[kept][order])


@dataclass(frozen=True)
class Beliefs:
    """Standard deviations of told poses (m and rad, per axis) and of sightings (at unit distance)."""

    position_std: float
    angle_std: float
    noise: float


@dataclass(frozen=True)
class Bundle:
    """A solution: camera-to-world rotations and positions (OpenGL axes), points, all in metres."""

    rotation: Float[np.ndarray, "n 3 3"]
    position: Float[np.ndarray, "n 3"]
    points: Float[np.ndarray, "m 3"]

    def moved(self, cameras: Float[np.ndarray, "n 6"], points: Float[np.ndarray, "m 3"]) -> "Bundle":
        """Adds (translation, rotation about the camera's own axes) to every camera and a step to every point."""
        turned = self.rotation @ Rotation.from_rotvec(cameras[:, 3:]).as_matrix()
        return Bundle(turned, self.position + cameras[:, :3], self.points + points)

    def from_told(self, told: "Bundle") -> Float[np.ndarray, "n 6"]:
        """How far every camera is from another bundle's, metres and radians about its own axes."""
        turn = Rotation.from_matrix(told.rotation.transpose(0, 2, 1) @ self.rotation).as_rotvec()
        return np.concatenate([self.position - told.position, turn], axis=1)


def triangulated(
    rotation: Float[np.ndarray, "n 3 3"], position: Float[np.ndarray, "n 3"], seen: Sightings
) -> Float[np.ndarray, "m 3"]:
    """Returns the places nearest to all rays of each point (least squares of the distances)."""
    away = np.concatenate([seen.place, -np.ones((len(seen.place), 1))], axis=1)
    away = np.einsum("kij,kj->ki", rotation[seen.camera], away / np.linalg.norm(away, axis=1, keepdims=True))
    across = np.eye(3) - away[:, :, None] * away[:, None, :]
    start = _starts(seen.point)
    # a little pull towards the cameras' middle keeps points defined that are seen along one line alone
    middle = np.add.reduceat(position[seen.camera], start) / np.diff([*start, len(seen.point)])[:, None]
    total = np.add.reduceat(across, start) + 1e-9 * np.eye(3)
    moment = np.add.reduceat(np.einsum("kij,kj->ki", across, position[seen.camera]), start) + 1e-9 * middle
    return np.linalg.solve(total, moment[..., None])[..., 0]


def adjusted(
    told: Bundle, first: Bundle, seen: Sightings, beliefs: Beliefs, scale: float, most_steps: int = 30
) -> Bundle:
    """Returns the bundle that explains the sightings best, searched from `first`."""
    bundle, cost, damping = first, _cost(first, told, seen, beliefs, scale), DAMPING
    for _ in range(most_steps):
        system = _System.at(bundle, told, seen, beliefs, scale)
        while True:
            tried = bundle.moved(*system.step(damping))
            new = _cost(tried, told, seen, beliefs, scale)
            if new < cost or damping > MOST_DAMPING:
                break
            damping *= 5
        if not new < cost:
            break
        gain, bundle, cost, damping = (cost - new) / cost, tried, new, max(damping / 5, LEAST_DAMPING)
        if gain < ENOUGH:
            break
    return bundle


def errors(bundle: Bundle, seen: Sightings) -> tuple[Float[np.ndarray, "k 2"], Float[np.ndarray, "k 3"]]:
    """Returns how far every sighting is off at unit distance (inf behind the camera), and the points in the camera's
    frame."""
    away = bundle.points[seen.point] - bundle.position[seen.camera]
    local = np.einsum("kji,kj->ki", bundle.rotation[seen.camera], away)
    ahead = -local[:, 2:]
    shown = np.where(ahead > NEAREST, local[:, :2] / np.maximum(ahead, NEAREST), np.inf)
    return shown - seen.place, local


def _cost(bundle: Bundle, told: Bundle, seen: Sightings, beliefs: Beliefs, scale: float) -> float:
    off, _ = errors(bundle, seen)
    squared = np.minimum(np.square(off / beliefs.noise).sum(axis=1), MOST)
    own = scale**2 * np.log1p(squared / scale**2)
    return float(own.sum() + np.square(bundle.from_told(told) / _stds(beliefs)).sum())


def _stds(beliefs: Beliefs) -> Float[np.ndarray, " 6"]:
    return np.repeat([beliefs.position_std, beliefs.angle_std], 3)


@dataclass(frozen=True)
class _System:
    """Normal equations at a bundle: blocks of cameras, of points, and between them."""

    camera: Int[np.ndarray, " k"]
    point: Int[np.ndarray, " k"]
    cameras: Float[np.ndarray, "n 6 6"]
    points: Float[np.ndarray, "m 3 3"]
    between: Float[np.ndarray, "k 6 3"]
    pull_cameras: Float[np.ndarray, "n 6"]
    pull_points: Float[np.ndarray, "m 3"]

    @classmethod
    def at(cls, bundle: Bundle, told: Bundle, seen: Sightings, beliefs: Beliefs, scale: float) -> "_System":
        """Linearises; sightings weigh as the robust cost has it."""
        off, local = errors(bundle, seen)
        good = np.isfinite(off).all(axis=1)
        off = np.where(good[:, None], off, 0.0) / beliefs.noise
        weight = good / (1 + np.square(off).sum(axis=1) / scale**2)
        by_camera, by_point = _slopes(local, bundle.rotation[seen.camera], good)
        by_camera, by_point = by_camera / beliefs.noise, by_point / beliefs.noise
        heavy_camera, heavy_point = by_camera * weight[:, None, None], by_point * weight[:, None, None]
        count, start = len(bundle.position), _starts(seen.point)
        certain = np.square(1 / _stds(beliefs))
        blocks = _summed(np.einsum("kai,kaj->kij", heavy_camera, by_camera), seen.camera, count) + np.diag(certain)
        pull = _summed(np.einsum("kai,ka->ki", heavy_camera, off), seen.camera, count)
        places = np.add.reduceat(np.einsum("kai,kaj->kij", heavy_point, by_point), start)
        pull_places = np.add.reduceat(np.einsum("kai,ka->ki", heavy_point, off), start)
        between = np.einsum("kai,kaj->kij", heavy_camera, by_point)
        pull += bundle.from_told(told) * certain
        return cls(seen.camera, seen.point, blocks, places, between, pull, pull_places)

    def step(self, damping: float) -> tuple[Float[np.ndarray, "n 6"], Float[np.ndarray, "m 3"]]:
        """Solves for the step of all cameras and points, points eliminated."""
        inverse = np.linalg.inv(_damped(self.points, damping) + 1e-9 * np.eye(3))
        n, m = len(self.cameras), len(self.points)
        between = self._sparse(self.between, n, m)
        halved = self._sparse(self.between @ inverse[self.point], n, m)
        reduced = -(halved @ between.T).toarray()
        places = np.arange(6 * n).reshape(n, 6)
        reduced[places[:, :, None], places[:, None, :]] += _damped(self.cameras, damping)
        right = halved @ self.pull_points.ravel() - self.pull_cameras.ravel()
        cameras = np.linalg.solve(reduced, right)
        rest = self.pull_points + (between.T @ cameras).reshape(m, 3)
        return cameras.reshape(n, 6), -np.einsum("mij,mj->mi", inverse, rest)

    def _sparse(self, blocks: Float[np.ndarray, "k 6 3"], n: int, m: int) -> csr_matrix:
        rows = np.broadcast_to((6 * self.camera[:, None] + np.arange(6))[:, :, None], blocks.shape)
        columns = np.broadcast_to((3 * self.point[:, None] + np.arange(3))[:, None, :], blocks.shape)
        return csr_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(6 * n, 3 * m))


def _slopes(
    local: Float[np.ndarray, "k 3"], rotation: Float[np.ndarray, "k 3 3"], good: np.ndarray
) -> tuple[Float[np.ndarray, "k 2 6"], Float[np.ndarray, "k 2 3"]]:
    """Derivatives of image points by camera (translation, rotation about own axes) and by point."""
    x, y, ahead = local[:, 0], local[:, 1], np.where(good, -local[:, 2], 1.0)
    zero = np.zeros_like(x)
    image = np.stack([1 / ahead, zero, x / ahead**2, zero, 1 / ahead, y / ahead**2], axis=1).reshape(-1, 2, 3)
    by_point = image @ rotation.transpose(0, 2, 1)
    # turning a camera about its axis w moves a point in its frame by local x w
    z = local[:, 2]
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    return np.concatenate([-by_point, image @ cross], axis=2), by_point


def _damped(blocks: Float[np.ndarray, "n d d"], damping: float) -> Float[np.ndarray, "n d d"]:
    size = blocks.shape[1]
    return blocks + damping * blocks * np.eye(size)


def _summed(values: np.ndarray, group: Int[np.ndarray, " k"], groups: int) -> np.ndarray:
    """Sums rows by group; groups may be empty."""
    flat = values.reshape(len(values), -1)
    columns = [np.bincount(group, column, minlength=groups) for column in flat.T]
    return np.stack(columns, axis=1).reshape(groups, *values.shape[1:])


def _starts(sorted_numbers: Int[np.ndarray, " k"]) -> Int[np.ndarray, " m"]:
    """Where every number begins in sorted ones, none of which is missing."""
    return np.searchsorted(sorted_numbers, np.arange(int(sorted_numbers[-1]) + 1))
