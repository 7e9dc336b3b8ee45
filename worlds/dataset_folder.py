"""Making a data set folder in one step: rendered beside its place, then renamed, so that nobody sees half of one."""

import contextlib
import errno
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from hashnerf.errors import UserError
from hashnerf.transforms_json import read_transforms
from worlds.checks import check_between
from worlds.cube_cylinder import CubeCylinderConfig
from worlds.dataset import world_description, write_dataset
from worlds.glb import export_glb
from worlds.intersection import IntersectionConfig
from worlds.mini_city import MiniCityConfig
from worlds.one_box import OneBoxConfig
from worlds.scenarios import SCENARIOS, ScenarioConfig, build_world
from worlds.scene import Scene
from worlds.single_scene_intersection import SingleSceneIntersectionConfig
from worlds.two_lane_merge import TwoLaneMergeConfig


@dataclass(frozen=True)
class DatasetConfig:
    """What to render and where to."""

    scenario: Literal[
        "intersection", "two_lane_merge", "single_scene_intersection", "cube_cylinder", "mini_city", "one_box"
    ] = "intersection"
    """Which scenario; its settings are in the group of the same name."""
    seed: int = 0
    """Varies layout, sizes, colours and cameras within what the settings allow."""
    image_size: int = 128
    """Width and height of the images, pixels."""
    workers: int = 2
    """Processes that render; the files do not depend on it."""
    out: Path | None = None
    """Folder of the data set; data/<scenario> when not given."""
    overwrite: bool = False
    """Replace another data set in that folder."""
    glb: Path | None = None
    """Also write the last state's scene as a GLB file, for Blender."""
    intersection: IntersectionConfig = field(default_factory=IntersectionConfig)
    """Settings of the multi-scene intersection."""
    two_lane_merge: TwoLaneMergeConfig = field(default_factory=TwoLaneMergeConfig)
    """Settings of the two-lane merge."""
    single_scene_intersection: SingleSceneIntersectionConfig = field(default_factory=SingleSceneIntersectionConfig)
    """Settings of the single-scene intersection."""
    cube_cylinder: CubeCylinderConfig = field(default_factory=CubeCylinderConfig)
    """Settings of the cube and cylinder."""
    mini_city: MiniCityConfig = field(default_factory=MiniCityConfig)
    """Settings of the mini-city and its survey."""
    one_box: OneBoxConfig = field(default_factory=OneBoxConfig)
    """Settings of the box in the air."""

    def __post_init__(self) -> None:
        check_between("seed", self.seed, 0, 2**32 - 1)
        check_between("image_size", self.image_size, 8, 4096)
        check_between("workers", self.workers, 1, 256)
        for name in SCENARIOS:
            settings = getattr(self, name)
            if name != self.scenario and settings != type(settings)():
                raise UserError(
                    f"{name}: settings are given, but scenario = {self.scenario}; remove them or change it."
                )

    @property
    def folder(self) -> Path:
        """Where the data set goes."""
        return self.out or Path("data") / self.scenario

    @property
    def world(self) -> ScenarioConfig:
        """The settings of the chosen scenario."""
        return getattr(self, self.scenario)


@dataclass(frozen=True)
class MadeDataset:
    """What `make_dataset` did."""

    document: dict[str, Any]
    """The data set's transforms.json."""
    rendered: bool
    """False when an identical data set was there already."""
    seconds: float
    """Wall time."""


def make_dataset(
    config: DatasetConfig, on_camera: Callable[[int, int], None] = lambda done, total: None
) -> MadeDataset:
    """Renders the data set unless it is there; UserError when the folder holds anything else and `overwrite` is off."""
    start = time.monotonic()
    world = build_world(config.world, config.seed)
    if config.glb is not None:
        export_glb(Scene(world, world.states[-1].poses), config.glb)
    folder = config.folder
    found = _existing(folder)
    if found is not None and _is_same(found, world_description(world), config.image_size):
        return MadeDataset(found, False, time.monotonic() - start)
    if found is not None and not config.overwrite:
        raise UserError(f"{folder}: holds another data set; give --overwrite true to replace it, or another --out.")
    try:
        document = _render_into_place(config, folder, on_camera)
    except OSError as error:
        if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR, errno.EEXIST):
            raise UserError(f"{folder}: cannot be written ({error.strerror}); give another --out.") from error
        raise
    return MadeDataset(document, True, time.monotonic() - start)


def _existing(folder: Path) -> dict[str, Any] | None:
    """The document of the data set in `folder`, None where nothing is; UserError for anything that is no data set."""
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return None
    if not (folder / "transforms.json").is_file():
        raise UserError(f"{folder}: is not empty and not a data set; give another --out.")
    return read_transforms(folder / "transforms.json")


def _is_same(document: dict[str, Any], description: dict[str, Any], image_size: int) -> bool:
    return document.get("world") == description and document.get("w") == image_size


def _render_into_place(config: DatasetConfig, folder: Path, on_camera: Callable[[int, int], None]) -> dict[str, Any]:
    folder.parent.mkdir(parents=True, exist_ok=True)
    partial = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        os.chmod(partial, 0o755)
        document = write_dataset(config.world, config.seed, partial, config.image_size, config.workers, on_camera)
        if folder.exists():
            old = Path(tempfile.mkdtemp(prefix=f".{folder.name}.old.", dir=folder.parent))
            os.replace(folder, old)
            os.replace(partial, folder)
            shutil.rmtree(old)
        else:
            os.replace(partial, folder)
    finally:
        with contextlib.suppress(FileNotFoundError):
            shutil.rmtree(partial)
    return document
