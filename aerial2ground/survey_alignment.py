"""A drone's pictures aligned with each other before anything is learned from them.

Motion capture errs by millimetres, GPS by centimetres at this scale; a radiance field shows either as blur, and pulling
on poses through it mends only errors of a few pixels. Here points of the flat ground are followed from picture to
picture and poses and points are adjusted to them; pictures laid out anew from better poses show more points, better.
"""

import json
import math
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from torch import Tensor

from aerial2ground.bundle_adjustment import Beliefs, Bundle, Sightings, adjusted, errors, triangulated
from aerial2ground.ground_tracks import Raster, track_ground
from aerial2ground.road_network import read_road_network
from hashnerf.errors import UserError
from hashnerf.posed_images import PosedImages, load_posed_images
from hashnerf.transforms_json import read_transforms, write_atomically, write_transforms

NOISE = 0.5
"""Pixels: what a sighting counts for. Places are found more exactly, but neighbours err alike."""
FIRST_SCALES, LATER_SCALES = (16.0, 4.0, 1.4), (4.0, 1.4)
"""Multiples of NOISE from which errors are taken for mistakes, the last after the first has brought things near."""
MOST_PICTURES = 400
"""All pairs of pictures are compared: a hundred take a minute, so many a quarter of an hour."""
WIDEST = 3
"""Halvings of pictures on the ground at the first look; more leave nothing of where they overlap."""
FEWEST_SIGHTINGS = 6
"""A picture with fewer keeps its told pose: three points fix one only just."""
LARGEST_ERROR = 1000.0
"""Largest standard deviation of told poses, metres or degrees: beyond it nothing is told."""
FARTHEST = float(chi2.ppf(0.999, 6))
"""Square of the distance from the told pose, in its standard deviations, beyond which a picture was misled."""


@dataclass(frozen=True)
class AlignmentConfig:
    """How a survey's pictures are aligned on flat ground."""

    position_std: float = 0.03
    """Standard deviation of each told coordinate, metres."""
    angle_std: float = 2.0
    """Standard deviation of the told orientation about each axis, degrees."""
    rounds: int = 5
    """How often points are followed and poses adjusted to them."""
    corners: int = 40
    """Points of every picture that are looked for in the others."""

    def __post_init__(self):
        if self.rounds < 1:
            raise UserError(f"alignment.rounds is {self.rounds}; give at least 1")
        for key in ("position_std", "angle_std"):
            if not 0 < getattr(self, key) <= LARGEST_ERROR:
                raise UserError(
                    f"alignment.{key} is {getattr(self, key)}; give a positive number up to {LARGEST_ERROR:g}"
                )
        if self.corners < 8:
            raise UserError(f"alignment.corners is {self.corners}; give at least 8")


@dataclass(frozen=True)
class Aligned:
    """Poses of a survey after alignment, and how far the points were from where they should be seen."""

    poses: Float[Tensor, "n 4 4"]
    sightings: int
    median_px: float
    """Median error, pixels."""
    kept: tuple[int, ...]
    """Pictures that keep their told pose: too little of the ground ties them to the others."""


OnRound = Callable[[int, int, float], None]
"""Is told the number of a finished round, its sightings and their median error (pixels)."""


def align_survey(
    data: PosedImages, height: float, config: AlignmentConfig, on_round: OnRound = lambda number, sightings, px: None
) -> Aligned:
    """Aligns all pictures of `data` over the ground at z = `height` (m); raises UserError where too little is seen.

    The same for more than MOST_PICTURES pictures.
    """
    if len(data) > MOST_PICTURES:
        raise UserError(
            f"{data.folder}: has {len(data)} training pictures, and all pairs are compared; "
            f"align a survey of at most {MOST_PICTURES}, taken from above"
        )
    pose = data.cameras.pose.double().numpy()
    told = bundle = Bundle(pose[:, :3, :3], pose[:, :3, 3], np.zeros((0, 3)))
    pictures, focal = data.images.numpy(), float(data.cameras.focal.mean())
    beliefs = Beliefs(config.position_std, math.radians(config.angle_std), NOISE / focal)
    raster = Raster.over(data.cameras, data.scene_box, height)
    expected = focal * beliefs.angle_std + config.position_std / raster.pixel
    seen, median, lost = Sightings.none(), math.nan, np.zeros(len(pose), bool)
    for number in range(config.rounds):
        cameras = replace(data.cameras, pose=_poses(bundle))
        # each halving of the pictures doubles the reach of the flow, which is a few pixels; who is lost is far off
        halvings = min(math.ceil(math.log2(max(expected, 1.0))), WIDEST)
        reach = np.maximum(np.where(lost, halvings, halvings - number), 1)
        seen = track_ground(pictures, cameras, raster, config.corners, reach)
        if not seen.points:
            raise UserError(
                f"{data.folder}: no point of the ground at z = {height:g} m is found in three pictures; "
                "is the height right, are the poses metres, and do the pictures overlap?"
            )
        bundle = Bundle(bundle.rotation, bundle.position, triangulated(bundle.rotation, bundle.position, seen))
        for scale in LATER_SCALES if number else FIRST_SCALES:
            bundle = adjusted(told, bundle, seen, beliefs, scale)
        median = float(np.median(np.linalg.norm(errors(bundle, seen)[0], axis=1))) * focal
        on_round(number + 1, len(seen.point), median)
        lost = np.bincount(seen.camera, minlength=len(pose)) < FEWEST_SIGHTINGS
        lost |= distances(told, bundle, beliefs) > FARTHEST
        bundle = Bundle(
            np.where(lost[:, None, None], told.rotation, bundle.rotation),
            np.where(lost[:, None], told.position, bundle.position),
            bundle.points,
        )
    return Aligned(_poses(bundle), len(seen.point), median, tuple(np.nonzero(lost)[0].tolist()))


def distances(told: Bundle, bundle: Bundle, beliefs: Beliefs) -> Float[np.ndarray, " n"]:
    """Returns squares of how far poses are from told ones, in standard deviations, less what most have in common."""
    moved = bundle.position - told.position
    turned = Rotation.from_matrix(told.rotation.transpose(0, 2, 1) @ bundle.rotation).as_rotvec()
    moved = (moved - np.median(moved, axis=0)) / beliefs.position_std
    return (moved**2).sum(axis=1) + ((turned / beliefs.angle_std) ** 2).sum(axis=1)


def align_folder(
    folder: Path, out: Path, config: AlignmentConfig, on_round: OnRound = lambda number, sightings, px: None
) -> Aligned:
    """Writes a copy of a data set in which the training pictures are aligned; held-out ones keep their told poses.

    alignment.json in the copy tells what was done. Raises UserError for an `out` that is there and for a data set
    without level roads, whose height is that of the ground.
    """
    if out.exists():
        raise UserError(f"{out}: is there already; give another folder or remove it")
    if out.resolve().is_relative_to(folder.resolve()):
        raise UserError(f"{out}: lies within the data set that it would be a copy of; give a folder elsewhere")
    out.parent.mkdir(parents=True, exist_ok=True)
    source = folder / "transforms.json"
    data = load_posed_images(folder)
    network = read_road_network(data.extras.get("road_network"), data.origin, str(source))
    if network.heights is not None:
        raise UserError(f"{source}: its roads are not level; pictures can be aligned over flat ground only")
    train = data.split("train")
    aligned = align_survey(train, network.height, config, on_round)
    poses = aligned.poses.double()
    poses[:, :3, 3] += data.origin
    found = {frame.file_path: pose.tolist() for frame, pose in zip(train.frames, poses)}
    document = read_transforms(source)
    for frame in document["frames"]:
        frame["transform_matrix"] = found.get(frame["file_path"], frame["transform_matrix"])
    about = {"from": str(folder), "alignment": asdict(config)}
    kept = [train.frames[row].file_path for row in aligned.kept]
    about |= {"sightings": aligned.sightings, "median_px": aligned.median_px, "kept_as_told": kept}
    with tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as place:
        fresh = Path(place) / out.name
        shutil.copytree(folder, fresh)
        write_transforms(fresh / "transforms.json", document)
        write_atomically(fresh / "alignment.json", json.dumps(about, indent=1, allow_nan=False).encode())
        fresh.replace(out)
    return aligned


def _poses(bundle: Bundle) -> Float[Tensor, "n 4 4"]:
    poses = np.tile(np.eye(4), (len(bundle.position), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = bundle.rotation, bundle.position
    return torch.from_numpy(poses).float()
