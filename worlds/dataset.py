"""Rendering a world into a data set folder: images, depth, and every ground-truth fact in `transforms.json`.

Each view follows from (config, seed) alone, so the files do not depend on the number of worker processes.
"""

import json
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from hashnerf.cameras import Cameras
from hashnerf.transforms_json import write_transforms
from hashnerf.worker_processes import map_in_processes
from worlds.raycast import Caster
from worlds.scenarios import ScenarioConfig, build_world
from worlds.scene import Scene, World
from worlds.view import StaticView

VERSION = 3
"""Rises when the same config and seed give other pictures; a data set of another version is not up to date."""

TRUTH = "truth.json"
"""True poses by camera, beside a transforms.json whose poses are not exact: for evaluation alone."""

Visibility = dict[str, list[list[int]]]
"""Rows [branch, step, camera, visible px, px without occluders] by actor."""


def world_description(world: World) -> dict[str, Any]:
    """The `world` entry of a data set: enough to build the same world again."""
    return {"scenario": world.scenario, "seed": world.seed, "version": VERSION, "config": asdict(world.config)}


def write_dataset(
    config: ScenarioConfig,
    seed: int,
    folder: Path,
    image_size: int,
    workers: int,
    on_camera: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Renders every state from every camera into the empty `folder`; returns what it wrote to `transforms.json`."""
    world = build_world(config, seed)
    (folder / "images").mkdir()
    (folder / "depth").mkdir()
    visibility: Visibility = {name: [] for name in world.actors}
    total = len(world.rig.kinds)
    make = partial(_Renderer, config, seed, folder, image_size)
    for done, part in enumerate(map_in_processes(make, range(total), workers, chunk=4), 1):
        for name, rows in part.items():
            visibility[name] += rows
        on_camera(done, total)
    document = describe(world, image_size, {name: sorted(rows) for name, rows in visibility.items()})
    write_transforms(folder / "transforms.json", document)
    if world.rig.told is not None:
        truth = {"poses": world.rig.cameras.pose.tolist()}
        (folder / TRUTH).write_text(json.dumps(truth), encoding="utf-8")
    return document


def scaled_cameras(world: World, image_size: int) -> Cameras:
    """The rig's cameras with pictures `image_size` pixels wide, their shape unchanged."""
    cameras = world.rig.cameras
    return cameras.scaled(image_size, round(image_size * cameras.height / cameras.width))


def view_name(branch: int, step: int, camera: int) -> str:
    """File name of a view without its folder."""
    return f"b{branch}_s{step}_c{camera:03d}.png"


class _Renderer:
    """Writes all states as one camera sees them."""

    def __init__(self, config: ScenarioConfig, seed: int, folder: Path, image_size: int):
        self.world, self.folder = build_world(config, seed), folder
        self.cameras: Cameras = scaled_cameras(self.world, image_size)
        self.scenes = [Scene(self.world, state.poses) for state in self.world.states]
        self.alone = [
            {name: Caster([(1, scene.mesh(name))]) for name in self.world.actors if name in scene.poses}
            for scene in self.scenes
        ]

    def __call__(self, index: int) -> Visibility:
        static = StaticView(self.world.stage, self.cameras, index)
        visibility: Visibility = {name: [] for name in self.world.actors}
        for state, scene, alone in zip(self.world.states, self.scenes, self.alone):
            view = static.with_bodies(scene.bodies)
            name = view_name(state.branch, state.step, index)
            Image.fromarray(view.rgb).save(self.folder / "images" / name, compress_level=5)
            millimetres = np.rint(np.clip(view.depth * 1000.0, 0.0, 65535.0)).astype(np.uint16)
            Image.fromarray(millimetres).save(self.folder / "depth" / name, compress_level=3)
            for actor, body in alone.items():
                visible = int((view.object_id == self.world.object_id(actor)).sum())
                visibility[actor].append([state.branch, state.step, index, visible, static.pixels_of(body)])
        return visibility


def describe(world: World, image_size: int, visibility: Visibility) -> dict[str, Any]:
    """The `transforms.json` of a world."""
    actors: dict[str, list[dict[str, Any]]] = {name: [] for name in world.actors}
    for state in world.states:
        scene = Scene(world, state.poses)
        for name in scene.poses:
            box = scene.box(name)
            place = {"center": list(box.center), "size": list(box.size), "yaw": box.yaw}
            actors[name].append({"branch": state.branch, "step": state.step, **place})
    cameras = scaled_cameras(world, image_size)
    return {
        "camera_model": "OPENCV",
        "w": cameras.width,
        "h": cameras.height,
        "scene_box": world.scene_box.tolist(),
        "camera_kinds": list(world.rig.kinds),
        "states": [{"branch": s.branch, "step": s.step, "hazard": s.hazard} for s in world.states],
        "branches": list(world.branches),
        "branch_weights": list(world.branch_weights or [1.0] * len(world.branches)),
        "actors": actors,
        "visibility": visibility,
        "world": world_description(world),
        **world.extras,
        "frames": _frames(world, cameras),
    }


def _frames(world: World, cameras: Cameras) -> list[dict[str, Any]]:
    poses = cameras.pose if world.rig.told is None else world.rig.told
    frames = []
    for state in world.states:
        for index, split in enumerate(world.rig.splits):
            name = view_name(state.branch, state.step, index)
            (fl_x, fl_y), (cx, cy) = cameras.focal[index].tolist(), cameras.centre[index].tolist()
            frame = {"file_path": f"images/{name}", "depth_path": f"depth/{name}"}
            frame |= {"branch": state.branch, "step": state.step, "camera": index, "split": split}
            frame |= {"fl_x": fl_x, "fl_y": fl_y, "cx": cx, "cy": cy}
            frame |= dict(zip(("k1", "k2", "p1", "p2"), cameras.distortion[index].tolist()))
            frames.append(frame | {"transform_matrix": poses[index].tolist()})
    return frames
