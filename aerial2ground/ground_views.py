"""Ground views of the reconstructed town as a data set: pictures, depth, poses of car and camera, arc lengths (III-C).

The folder is a posed-image data set like any other (transforms.json, images/, depth/), with `car_pose`, `arc` and
`steering` added to every frame. Views are rendered by several processes; a view whose files are there is not rendered
again, so an interrupted call continues.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from aerial2ground.car_camera import CarCameraConfig, car_cameras
from aerial2ground.depth_channel import with_depth
from aerial2ground.ground_poses import GroundPoses
from aerial2ground.ground_truth import axis_depth
from aerial2ground.reconstruction import RoadNerf
from hashnerf.cameras import Cameras
from hashnerf.errors import UserError
from hashnerf.image_files import read_depth, read_rgb, resolve_inside, write_png
from hashnerf.render import RAYS_AT_ONCE
from hashnerf.transforms_json import read_transforms, write_transforms
from hashnerf.worker_processes import map_in_processes

Picture = tuple[UInt8[np.ndarray, "h w 3"], Float[np.ndarray, "h w"]]
Renderer = Callable[[Cameras, Sequence[int]], Iterable[Picture]]
"""The pictures of some cameras, in order."""
FAR = 65.0
"""Metres from which a depth map cannot tell more (16-bit millimetres)."""


def nerf_renderer(nerf: RoadNerf) -> Renderer:
    """Returns a function that renders colour and depth (m, along the axis, 0 where nothing is) of some cameras."""

    def render(cameras: Cameras, indices: Sequence[int]) -> Iterator[Picture]:
        seen, shape = nerf.views(cameras, indices), (len(indices), cameras.height, cameras.width)
        colours = (seen.rgb.clamp(0, 1) * 255).round().to(torch.uint8).view(*shape, 3)
        for index, rgb, distance in zip(indices, colours, seen.median_depth.view(len(indices), -1)):
            depth = axis_depth(cameras, index, distance)
            yield rgb.numpy(), torch.where(depth.isfinite(), depth, 0.0).numpy()

    return render


def render_views(
    make_renderer: Callable[[], Renderer],
    sets: Sequence[tuple[Cameras, FilePath]],
    workers: int,
    on_view: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Writes images/ and depth/ of every camera that has none yet in the folder of its set.

    `make_renderer` is called once a process; `on_view` is told how many views are there, and of how many.
    """
    total, batches = sum(len(cameras) for cameras, _ in sets), []
    for number, (cameras, folder) in enumerate(sets):
        missing = [index for index in range(len(cameras)) if not is_there(folder, index)]
        size = max(1, RAYS_AT_ONCE // (cameras.width * cameras.height))
        batches += [(number, missing[at : at + size]) for at in range(0, len(missing), size)]
    done = total - sum(len(indices) for _, indices in batches)
    on_view(done, total)
    for written in map_in_processes(_Writer(make_renderer, sets), batches, workers):
        done += written
        on_view(done, total)


def is_there(folder: FilePath, index: int) -> bool:
    """Whether both files of a view exist; they are renamed into place, so what exists is whole."""
    return all((folder / kind / view_name(index)).is_file() for kind in ("depth", "images"))


def view_name(index: int) -> str:
    """File name of a view."""
    return f"{index:05d}.png"


def describe_views(
    cameras: Cameras,
    car: GroundPoses,
    steering: Float[np.ndarray, " n"],
    folder: FilePath,
    scene_box: Float[Tensor, "2 3"],
    extras: dict,
) -> None:
    """Writes transforms.json beside the pictures; `extras` are further entries of it."""
    frames = []
    for index in range(len(cameras)):
        name = view_name(index)
        frame = {"file_path": f"images/{name}", "branch": 0, "step": 0, "camera": index}
        if (folder / "depth" / name).is_file():
            frame["depth_path"] = f"depth/{name}"
        frame |= {"split": "train", "transform_matrix": cameras.pose[index].tolist()}
        frame |= {"car_pose": car.poses[index].tolist(), "arc": float(car.arc[index])}
        frames.append(frame | {"steering": float(steering[index])})
    focal, centre = cameras.focal[0].tolist(), cameras.centre[0].tolist()
    document = {"camera_model": "OPENCV", "w": cameras.width, "h": cameras.height, "fl_x": focal[0], "fl_y": focal[1]}
    document |= {"cx": centre[0], "cy": centre[1], "scene_box": scene_box.tolist(), **extras, "frames": frames}
    write_transforms(folder / "transforms.json", document)


def join_views(folder: FilePath, parts: Sequence[str], extras: dict) -> None:
    """Writes one transforms.json for the views in several folders below `folder`."""
    documents = [read_transforms(folder / part / "transforms.json") for part in parts]
    frames = [
        frame | {key: f"{part}/{frame[key]}" for key in ("file_path", "depth_path") if key in frame}
        for part, document in zip(parts, documents)
        for frame in document["frames"]
    ]
    frames = [frame | {"camera": number} for number, frame in enumerate(frames)]
    write_transforms(folder / "transforms.json", documents[0] | extras | {"frames": frames})


@dataclass(frozen=True)
class GroundViews:
    """A set of ground views in memory."""

    pictures: UInt8[Tensor, "n h w 3"]
    depth: Float[Tensor, "n h w"]
    """Metres along the optical axis, 0 where nothing is, NaN where it was not measured."""
    poses: Float[np.ndarray, "n 3"]
    arc: Float[np.ndarray, " n"]
    steering: Float[np.ndarray, " n"]

    @property
    def sky(self) -> Bool[Tensor, "n h w"]:
        """Where nothing is."""
        return self.depth == 0

    def rgbd(self, depth_range: float) -> UInt8[Tensor, "n h w 4"]:
        """Returns the pictures with depth up to `depth_range` metres as a fourth channel."""
        return torch.from_numpy(with_depth(self.pictures.numpy(), self.depth.numpy(), depth_range))


def load_views(folder: FilePath) -> GroundViews:
    """Reads a set of ground views; raises UserError for a folder that is none or not finished."""
    path = folder / "transforms.json"
    if not path.is_file():
        script = "make_ground_views.py --pictures drives" if "from_drives" in folder.parts else "make_ground_views.py"
        raise UserError(f"{folder}: no ground views here; run scripts/{script} first")
    frames = read_transforms(path).get("frames")
    if not frames:
        raise UserError(f"{path}: holds no frames")
    if any("car_pose" not in frame for frame in frames):
        raise UserError(f"{path}: frames lack car_pose; these are no ground views")
    try:
        pictures = np.stack([read_rgb(resolve_inside(folder, frame["file_path"])) for frame in frames])
        depth = np.full(pictures.shape[:3], np.nan, np.float32)
        for number, frame in enumerate(frames):
            if "depth_path" in frame:
                depth[number] = read_depth(resolve_inside(folder, frame["depth_path"])) / 1000
        numbers = [[float(frame[key]) for frame in frames] for key in ("arc", "steering")]
        poses = np.array([frame["car_pose"] for frame in frames], dtype=float).reshape(len(frames), 3)
    except (UserError, KeyError, TypeError, ValueError) as error:
        what = f"a frame lacks {error}" if isinstance(error, KeyError) else error
        raise UserError(
            f"{folder}: holds damaged ground views ({what}); delete the folder and make them again"
        ) from error
    return GroundViews(
        torch.from_numpy(pictures), torch.from_numpy(depth), poses, np.array(numbers[0]), np.array(numbers[1])
    )


def cameras_of(camera: CarCameraConfig, car: GroundPoses, road_height: float | Float[Tensor, " n"]) -> Cameras:
    """Returns the car's camera at every pose."""
    return car_cameras(camera, torch.from_numpy(car.poses), road_height, torch.from_numpy(car.tilt))


@dataclass(frozen=True)
class _Writer:
    """Renders views and writes their files; small enough to be sent to another process."""

    make_renderer: Callable[[], Renderer]
    sets: Sequence[tuple[Cameras, FilePath]]

    def __call__(self) -> Callable[[tuple[int, Sequence[int]]], int]:
        renderer = self.make_renderer()

        def write(batch: tuple[int, Sequence[int]]) -> int:
            (cameras, folder), indices = self.sets[batch[0]], batch[1]
            for index, picture in zip(indices, renderer(cameras, indices)):
                write_view(folder, index, *picture)
            return len(indices)

        return write


def write_view(
    folder: FilePath, index: int, rgb: UInt8[np.ndarray, "h w 3"], depth: Float[np.ndarray, "h w"] | None
) -> None:
    """Writes a picture and its depth (m along the axis, 0 where nothing is), if there is one."""
    files: dict[str, np.ndarray] = {"images": rgb}
    if depth is not None:
        # the picture last: a view counts as there only with both
        files = {"depth": np.rint(np.clip(depth, 0.0, FAR) * 1000).astype(np.uint16)} | files
    for kind, array in files.items():
        (folder / kind).mkdir(parents=True, exist_ok=True)
        write_png(folder / kind / view_name(index), array)
