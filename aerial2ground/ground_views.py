"""Ground views of the reconstructed town as a data set: pictures, depth, poses of car and camera, arc lengths (III-C).

The folder is a posed-image data set like any other (transforms.json, images/, depth/), with `car_pose`, `arc` and
`steering` added to every frame. Views are rendered by several processes; a view whose files are there is not rendered
again, so an interrupted call continues.
"""

import multiprocessing
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from aerial2ground.car_camera import CarCameraConfig, car_cameras
from aerial2ground.ground_poses import GroundPoses
from aerial2ground.ground_truth import axis_depth
from aerial2ground.reconstruction import RoadNerf
from hashnerf.cameras import Cameras
from hashnerf.errors import UserError
from hashnerf.image_files import read_depth, read_rgb, resolve_inside, write_png
from hashnerf.transforms_json import read_transforms, write_transforms

Picture = tuple[UInt8[np.ndarray, "h w 3"], Float[np.ndarray, "h w"]]
Renderer = Callable[[Cameras, int], Picture]
FAR = 65.0
"""Metres from which a depth map cannot tell more (16-bit millimetres)."""


def nerf_renderer(nerf: RoadNerf) -> Renderer:
    """Returns a function that renders colour and depth (m, along the axis, 0 where nothing is) of a camera."""

    def render(cameras: Cameras, index: int) -> Picture:
        seen = nerf.view(cameras, index)
        depth = axis_depth(cameras, index, seen.median_depth)
        depth = torch.where(depth.isfinite(), depth, 0.0)
        rgb = (seen.rgb.clamp(0, 1) * 255).round().to(torch.uint8).view(cameras.height, cameras.width, 3)
        return rgb.numpy(), depth.numpy()

    return render


def render_views(
    make_renderer: Callable[[], Renderer],
    cameras: Cameras,
    folder: FilePath,
    workers: int,
    on_view: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Writes images/ and depth/ of every camera that has none yet; `make_renderer` is called once a process."""
    for name in ("images", "depth"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    missing = [index for index in range(len(cameras)) if not is_there(folder, index)]
    done = len(cameras) - len(missing)
    on_view(done, len(cameras))
    for _ in _written(make_renderer, cameras, folder, missing, workers):
        done += 1
        on_view(done, len(cameras))


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
    """Writes transforms.json beside the pictures."""
    frames = []
    for index in range(len(cameras)):
        name = view_name(index)
        frame = {"file_path": f"images/{name}", "depth_path": f"depth/{name}", "branch": 0, "step": 0, "camera": index}
        frame |= {"split": "train", "transform_matrix": cameras.pose[index].tolist()}
        frame |= {"car_pose": car.poses[index].tolist(), "arc": float(car.arc[index])}
        frames.append(frame | {"steering": float(steering[index])})
    focal, centre = cameras.focal[0].tolist(), cameras.centre[0].tolist()
    document = {"camera_model": "OPENCV", "w": cameras.width, "h": cameras.height, "fl_x": focal[0], "fl_y": focal[1]}
    document |= {"cx": centre[0], "cy": centre[1], "scene_box": scene_box.tolist(), **extras, "frames": frames}
    write_transforms(folder / "transforms.json", document)


@dataclass(frozen=True)
class GroundViews:
    """A set of ground views in memory."""

    pictures: UInt8[Tensor, "n h w 3"]
    depth: Float[Tensor, "n h w"]
    poses: Float[np.ndarray, "n 3"]
    arc: Float[np.ndarray, " n"]
    steering: Float[np.ndarray, " n"]


def load_views(folder: FilePath) -> GroundViews:
    """Reads a set of ground views; raises UserError for a folder that is none or not finished."""
    path = folder / "transforms.json"
    if not path.is_file():
        raise UserError(f"{folder}: no ground views here; run scripts/make_ground_views.py first")
    frames = read_transforms(path).get("frames")
    if not frames:
        raise UserError(f"{path}: holds no frames")
    if any("car_pose" not in frame for frame in frames):
        raise UserError(f"{path}: frames lack car_pose; these are no ground views")
    pictures = np.stack([read_rgb(resolve_inside(folder, frame["file_path"])) for frame in frames])
    depths = [read_depth(resolve_inside(folder, frame["depth_path"])) for frame in frames]
    depth = np.stack(depths).astype(np.float32) / 1000
    return GroundViews(
        torch.from_numpy(pictures),
        torch.from_numpy(depth),
        np.array([frame["car_pose"] for frame in frames]),
        np.array([frame["arc"] for frame in frames]),
        np.array([frame["steering"] for frame in frames]),
    )


def cameras_of(camera: CarCameraConfig, car: GroundPoses, road_height: float) -> Cameras:
    """Returns the car's camera at every pose."""
    return car_cameras(camera, torch.from_numpy(car.poses), road_height, torch.from_numpy(car.tilt))


_worker: tuple[Renderer, Cameras, FilePath] | None = None


def _start(make_renderer: Callable[[], Renderer], cameras: Cameras, folder: FilePath) -> None:
    global _worker
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    torch.set_num_threads(1)
    _worker = (make_renderer(), cameras, folder)


def _work(index: int) -> None:
    assert _worker is not None
    _write(*_worker, index)


def _write(renderer: Renderer, cameras: Cameras, folder: FilePath, index: int) -> None:
    rgb, depth = renderer(cameras, index)
    millimetres = np.rint(np.clip(depth, 0.0, FAR) * 1000).astype(np.uint16)
    # the picture last: a view counts as there only with both
    for kind, array in (("depth", millimetres), ("images", rgb)):
        write_png(folder / kind / view_name(index), array)


def _written(
    make_renderer: Callable[[], Renderer], cameras: Cameras, folder: FilePath, missing: list[int], workers: int
) -> Iterator[None]:
    if workers == 1 or len(missing) < 8:
        renderer = make_renderer() if missing else None
        for index in missing:
            assert renderer is not None
            _write(renderer, cameras, folder, index)
            yield
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, context, _start, (make_renderer, cameras, folder))
    try:
        yield from pool.map(_work, missing, chunksize=8)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
