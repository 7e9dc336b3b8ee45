"""A folder of posed images in memory: uint8 pictures, one camera row a picture, and what is known about the world.

A frame is a view: the image of a state (branch, step) from a camera. Everything inside a PosedImages (poses, scene_box,
actor boxes in `extras`) is in world metres minus `origin`, which is zero unless the data set lies kilometres from its
own origin, as map coordinates do.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from hashnerf.cameras import Cameras, any_sees
from hashnerf.errors import DataError, UserError
from hashnerf.image_files import read_depth, read_rgb, resolve_inside
from hashnerf.lens import COEFFICIENT_KEYS, LENS_KEYS, UNSUPPORTED_COEFFICIENTS, read_lens
from hashnerf.poses import default_scene_box, read_pose, scene_origin
from hashnerf.transforms_json import EXTRA_KEYS, check_extras, is_index, misspelled, read_transforms

SPLITS = ("train", "val", "test")
IMAGE_EXTENSIONS = (".png", ".jpg")
FRAME_KEYS = ("file_path", "transform_matrix", "branch", "step", "camera", "split", "depth_path")
CAMERA_KEYS = (*LENS_KEYS, *COEFFICIENT_KEYS, *UNSUPPORTED_COEFFICIENTS, "w", "h")
TOP_KEYS = ("frames", *EXTRA_KEYS, *CAMERA_KEYS)
READER_THREADS = 4
LARGEST_BOX = 1e9  # metres, from corner to corner


@dataclass(frozen=True)
class Frame:
    """What the file says about one view besides its picture and camera."""

    file_path: str
    split: str
    branch: int
    step: int
    camera: int
    depth_path: str | None = None


@dataclass(frozen=True)
class PosedImages:
    """Images with their cameras and frames, row by row, and the world they show."""

    images: UInt8[Tensor, "n h w 3"]
    cameras: Cameras
    frames: tuple[Frame, ...]
    scene_box: Float[Tensor, "2 3"]
    extras: dict
    folder: Path
    origin: Float[Tensor, " 3"] = field(default_factory=lambda: torch.zeros(3, dtype=torch.float64))
    box_told: bool = True
    """Whether the file states the box; else it is a loose one around all cameras and what lies ahead of them."""

    def __len__(self) -> int:
        return len(self.frames)

    def select(self, indices: Int[Tensor, " chosen"] | list[int]) -> "PosedImages":
        """The views with these row numbers, in the order given."""
        rows = torch.as_tensor(indices, dtype=torch.int64)
        frames = tuple(self.frames[row] for row in rows.tolist())
        return replace(self, images=self.images[rows], cameras=self.cameras.select(rows), frames=frames)

    def split(self, name: str) -> "PosedImages":
        """The views of one split (train, val or test), possibly none; raises UserError for another name."""
        if name not in SPLITS:
            raise UserError(f"the split {name!r} is not one of {', '.join(SPLITS)}")
        return self.select([row for row, frame in enumerate(self.frames) if frame.split == name])

    def with_test_every(self, every: int) -> "PosedImages":
        """The same with every `every`-th picture from the first held out, unless frames name splits or `every` is 0."""
        if not every or any(frame.split != "train" for frame in self.frames):
            return self
        frames = [replace(f, split="train" if row % every else "test") for row, f in enumerate(self.frames)]
        return replace(self, frames=tuple(frames))

    def with_scene_box(self, told: Sequence[float]) -> "PosedImages":
        """The same with another box (x0, y0, z0, x1, y1, z1), metres in the file's frame; unchanged if `told` is empty.

        Raises UserError for a box without volume, or one that no camera sees.
        """
        if not told:
            return self
        if not all(low < high and abs(low) + abs(high) <= LARGEST_BOX for low, high in zip(told[:3], told[3:])):
            raise UserError(
                f"scene_box is {list(told)}; give x0, y0, z0, x1, y1, z1 in metres, each of the first three below its "
                f"counterpart and none beyond {LARGEST_BOX:g}"
            )
        box = (torch.tensor(list(told), dtype=torch.float64).view(2, 3) - self.origin).float()
        if not any_sees(self.cameras, box):
            raise UserError(f"scene_box is {list(told)}; no camera sees it: give metres, in the poses' frame")
        return replace(self, scene_box=box, box_told=True)


@dataclass
class _View:
    """One frame while it is read; what could not be read stays None and has a line in `problems`."""

    name: str
    key: tuple[int, int, int] | None = None  # branch, step, camera
    frame: Frame | None = None
    path: Path | None = None
    pose: Float[np.ndarray, "4 4"] | None = None
    image: UInt8[np.ndarray, "h w 3"] | None = None
    size: tuple[int, int] | None = None  # width, height as stored
    lens: list[float] | None = None
    problems: list[str] = field(default_factory=list)
    lens_problems: list[str] = field(default_factory=list)
    key_problems: list[str] = field(default_factory=list)


def load_posed_images(folder: Path | str, image_size: int | None = None) -> PosedImages:
    """Reads a data set folder; `image_size` is a new, smaller width in pixels, reached by area averaging.

    Raises DataError with every problem of the folder at once.
    """
    folder = Path(folder)
    source = folder / "transforms.json"
    document = read_transforms(source)
    entries = document.get("frames")
    if not isinstance(entries, list) or not entries:
        slips = misspelled(document, TOP_KEYS)
        raise DataError(str(source), ["'frames' must be a list with at least one frame", *slips])
    if image_size is not None and image_size < 1:
        raise UserError(f"image_size = {image_size} must be at least 1 pixel")
    with ThreadPoolExecutor(READER_THREADS) as pool:
        rows = range(len(entries))
        views = list(pool.map(lambda row: _read_view(folder, document, row, entries[row], image_size), rows))
    problems = [f"{view.name}: {problem}" for view in views for problem in view.problems]
    problems += (
        _told_once(views, "key_problems")
        + _told_once(views, "lens_problems")
        + _across_views(views, document, image_size)
    )
    problems += misspelled(document, TOP_KEYS)
    problems += check_extras(document, [view.key for view in views if view.key is not None])
    if problems:
        raise DataError(str(source), problems)
    posed = _assemble(folder, document, views)
    if not any_sees(posed.cameras, posed.scene_box):
        unseen = f"scene_box {document['scene_box']}: no camera sees it; give it in metres, in the frame of the poses"
        raise DataError(str(source), [unseen])
    return posed


def missing_views(posed: PosedImages) -> list[tuple[int, int, int]]:
    """The (branch, step, camera) of every state and camera in the data set that no frame shows together, sorted."""
    present = {(frame.branch, frame.step, frame.camera) for frame in posed.frames}
    states = {(branch, step) for branch, step, _ in present}
    cameras = {camera for _, _, camera in present}
    return sorted({(*state, camera) for state in states for camera in cameras} - present)


def load_depth(posed: PosedImages) -> Float[Tensor, "n h w"]:
    """Depth along the optical axis in metres for every view, 0 where nothing was hit.

    A depth map larger than the images is sampled at the pixel centres: averaging would invent surfaces between the
    near and the far one. Raises DataError naming every view whose depth is missing or unreadable.
    """
    width, height = posed.cameras.width, posed.cameras.height
    maps, problems = [], []
    for frame in posed.frames:
        try:
            if frame.depth_path is None:
                raise UserError("has no depth_path in transforms.json")
            depth = read_depth(resolve_inside(posed.folder, frame.depth_path))
            if depth.shape[1] < width or round(depth.shape[0] * width / depth.shape[1]) != height:
                raise UserError(f"depth of {depth.shape[1]}x{depth.shape[0]} does not fit images of {width}x{height}")
        except UserError as error:
            problems.append(f"{frame.file_path}: {error}")
            continue
        rows = ((np.arange(height) + 0.5) * depth.shape[0] / height).astype(int)
        columns = ((np.arange(width) + 0.5) * depth.shape[1] / width).astype(int)
        maps.append(torch.from_numpy(depth[np.ix_(rows, columns)].astype(np.float32) / 1000))
    if problems:
        raise DataError(str(posed.folder), problems)
    return torch.stack(maps) if maps else torch.zeros(0, height, width)


def _read_view(folder: Path, document: dict, row: int, entry: object, image_size: int | None) -> _View:
    if not isinstance(entry, dict):
        return _View(f"frame {row}", problems=["must be an object with file_path and transform_matrix"])
    # One line a problem: a file name must not smuggle in line breaks or terminal codes.
    shown = "".join(letter if letter.isprintable() else "?" for letter in str(entry.get("file_path"))[:80])
    view = _View(f"frame {row} ({shown})")
    _read_frame(view, entry, row)
    view.key_problems = misspelled(entry, (*FRAME_KEYS, *CAMERA_KEYS))
    view.pose, problem = read_pose(entry.get("transform_matrix"))
    if problem is not None:
        view.problems.append(f"transform_matrix {problem}")
    try:
        if entry.get("depth_path") is not None:
            resolve_inside(folder, entry["depth_path"])
    except UserError as error:
        view.problems.append(f"depth_path: {error}")
    try:
        view.path = resolve_inside(folder, entry.get("file_path"), IMAGE_EXTENSIONS)
        image = read_rgb(view.path)
    except UserError as error:
        view.problems.append(str(error))
        return view
    view.size = (image.shape[1], image.shape[0])
    keys = {key: source[key] for source in (document, entry) for key in CAMERA_KEYS if key in source}
    stated = (keys.get("w", view.size[0]), keys.get("h", view.size[1]))
    if stated != view.size:
        view.problems.append(f"the file is {view.size[0]}x{view.size[1]} but w and h say {stated[0]}x{stated[1]}")
    view.lens, view.lens_problems = read_lens(keys, *view.size)
    view.image = image if image_size is None else _shrink(image, image_size)
    return view


def _read_frame(view: _View, entry: dict, row: int) -> None:
    numbers = {"branch": entry.get("branch", 0), "step": entry.get("step", 0), "camera": entry.get("camera", row)}
    split = entry.get("split", "train")
    bad = [
        f"{key} = {str(value)[:40]} must be an integer from 0 up"
        for key, value in numbers.items()
        if not is_index(value)
    ]
    if not bad:
        view.key = (numbers["branch"], numbers["step"], numbers["camera"])
    if split not in SPLITS:
        bad.append(f"split = {str(split)[:40]!r} is not one of {', '.join(SPLITS)}")
    view.problems += bad
    if not bad:
        view.frame = Frame(str(entry.get("file_path")), split, **numbers, depth_path=entry.get("depth_path"))


def _shrink(image: UInt8[np.ndarray, "h w 3"], width: int) -> UInt8[np.ndarray, "h2 w2 3"]:
    if width >= image.shape[1]:
        return image
    height = max(1, round(image.shape[0] * width / image.shape[1]))
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)


def _told_once(views: list[_View], kind: str) -> list[str]:
    """One line for each different problem: a slip in a program that writes the file repeats in every frame."""
    first: dict[str, list[str]] = {}
    for view in views:
        for problem in getattr(view, kind):
            first.setdefault(problem, []).append(view.name)
    return [
        f"{names[0]}: {problem}" + (f" (the same in {len(names) - 1} other frames)" if len(names) > 1 else "")
        for problem, names in first.items()
    ]


def _across_views(views: list[_View], document: dict, image_size: int | None) -> list[str]:
    """What only shows when frames are compared."""
    problems = []
    for noun, key_of in (
        ("(branch, step, camera)", lambda view: view.key),
        ("picture file", lambda view: view.path),
    ):
        first: dict = {}
        for view in views:
            key = key_of(view)
            if key is not None and first.setdefault(key, view) is not view:
                problems.append(f"{view.name}: has the same {noun} as {first[key].name}")
    sizes = {view.size: view.name for view in reversed(views) if view.size is not None}
    if len(sizes) > 1:
        listed = ", ".join(f"{size[0]}x{size[1]} in {name}" for size, name in list(sizes.items())[:5])
        problems.append(f"all pictures need one size, found {listed}")
    if image_size is not None and any(size[0] < image_size for size in sizes):
        problems.append(f"image_size = {image_size} would enlarge pictures of width {min(size[0] for size in sizes)}")
    framed = [view for view in views if view.frame is not None]
    poses = [view.pose for view in framed if view.pose is not None]
    if len({view.frame.camera for view in framed}) > 1 and len(poses) > 1 and all((p == poses[0]).all() for p in poses):
        problems.append("all cameras have the same pose; different cameras need their own transform_matrix")
    if document.get("states") is not None:
        problems += _shared_cameras(framed)
    return problems


def _shared_cameras(views: list[_View]) -> list[str]:
    """A camera in two splits is leakage: states share their background, so its test pictures would be known."""
    splits: dict[int, set[str]] = {}
    for view in views:
        splits.setdefault(view.frame.camera, set()).add(view.frame.split)
    return [
        f"camera {camera} is in the splits {' and '.join(sorted(names))}; each camera belongs to one split"
        for camera, names in sorted(splits.items())
        if len(names) > 1
    ]


def _assemble(folder: Path, document: dict, views: list[_View]) -> PosedImages:
    poses = np.stack([view.pose for view in views])
    box = np.array(document["scene_box"], float) if document.get("scene_box") else default_scene_box(poses)
    origin = scene_origin(poses[:, :3, 3])
    poses[:, :3, 3] -= origin  # in float64: float32 would round map coordinates to half a metre
    lens = torch.tensor([view.lens for view in views], dtype=torch.float32)
    width, height = views[0].size
    cameras = Cameras(torch.from_numpy(poses).float(), lens[:, :2], lens[:, 2:4], lens[:, 4:], width, height)
    images = torch.from_numpy(np.stack([view.image for view in views]))
    extras = {key: document[key] for key in document if key not in (*CAMERA_KEYS, "frames", "scene_box")}
    for boxes in (extras.get("actors") or {}).values():
        for actor in boxes:
            actor["center"] = [value - shift for value, shift in zip(actor["center"], origin.tolist())]
    return PosedImages(
        images,
        cameras.scaled(images.shape[2], images.shape[1]),
        tuple(view.frame for view in views),
        torch.from_numpy(box - origin).float(),
        extras,
        folder,
        torch.from_numpy(origin),
        bool(document.get("scene_box")),
    )
