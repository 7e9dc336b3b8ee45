"""What a data set holds, and which parts of the pipeline it is enough for, in words: read before training on it."""

import hashlib

from carff.encoders import SIDE_MULTIPLE
from carff.states import StateTable
from hashnerf.posed_images import SPLITS, PosedImages, missing_views

FEW_CAMERAS = 20


def summarise(data: PosedImages, table: StateTable) -> list[str]:
    """Returns a few lines: views, states, cameras, splits, pictures that are missing, and what cannot be done."""
    cameras = {name: len({frame.camera for frame in data.frames if frame.split == name}) for name in SPLITS}
    size = f"{data.cameras.width} x {data.cameras.height} pixels"
    branches = len({branch for branch, _ in table.states})
    lines = [
        f"{len(data)} views of {len(table)} states in {branches} branches, {size}",
        "cameras: " + ", ".join(f"{count} {name}" for name, count in cameras.items()),
    ]
    missing = missing_views(data)
    if missing:
        shown = ", ".join(map(str, missing[:3])) + (", ..." if len(missing) > 3 else "")
        lines.append(f"{len(missing)} (branch, step, camera) without a picture: {shown}")
    known = pictures_in_two_splits(data)
    if known:
        lines.append(
            f"note: {known} held-out pictures are equal to training pictures: what is measured on them flatters"
        )
    if data.cameras.width % SIDE_MULTIPLE or data.cameras.height % SIDE_MULTIPLE:
        needed = f"sides are not multiples of {SIDE_MULTIPLE} pixels, as the conv encoder needs"
        lines.append(f"note: {needed}: crop, or train with --image_size")
    return lines + [f"note: {reason}" for reason in limits(table)]


def pictures_in_two_splits(data: PosedImages) -> int:
    """Returns how many val and test views show, pixel by pixel, what a training view of another file shows."""
    digests = [hashlib.sha256(picture.numpy().tobytes()).digest() for picture in data.images]
    training = {digest for digest, frame in zip(digests, data.frames) if frame.split == "train"}
    return sum(digest in training for digest, frame in zip(digests, data.frames) if frame.split != "train")


def limits(table: StateTable) -> list[str]:
    """Returns one sentence for each part of the pipeline that the data set is not enough for."""
    reasons = []
    cameras = int((table.view_index("train") >= 0).any(dim=0).sum())
    if cameras == 0:
        reasons.append("no view has the split `train`")
    elif cameras < FEW_CAMERAS:
        reasons.append(f"{cameras} training cameras, few for a radiance field: expect wrong shapes, use dozens")
    if not (table.successor >= 0).any():
        reasons.append("every branch has a single step: train_mdn.py will refuse, as a forecast needs two or more")
    if not any(table.actors):
        reasons.append("no `actors`: futures can be rendered, but not read as present or absent")
    if table.hazard is None:
        reasons.append("`states` do not say what is a hazard: no decisions")
    return reasons
