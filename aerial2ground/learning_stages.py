"""From ground views to networks: collected drives, steering networks and localisers.

runs/<name>/{drives/<trajectory>/, from_drives/, policies/<trajectory>/<method>/<seed>/, localisers/<method>/<seed>/}.
A network that is there is not trained again; where the data set has no embedded world, nobody can collect pictures and
only `ours` is trained.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath

import numpy as np
from jaxtyping import UInt8
from torch import Tensor

from aerial2ground.config import AerialConfig, from_drives
from aerial2ground.depth_channel import depth_of
from aerial2ground.driving import Drive
from aerial2ground.evaluate_driving import drive_in
from aerial2ground.ground_poses import GroundPoses
from aerial2ground.ground_views import (
    GroundViews,
    cameras_of,
    describe_views,
    join_views,
    load_views,
    write_view,
)
from aerial2ground.imitation import METHODS, train_policy
from aerial2ground.localisation import save_localiser, train_localiser
from aerial2ground.networks import NetworkConfig, PictureNetwork
from aerial2ground.paths import Path
from aerial2ground.stages import Survey, load_driven_survey
from aerial2ground.teleoperation import Teleoperator
from hashnerf.checkpoints import load_checkpoint, load_module_state, module_tensors, save_checkpoint
from hashnerf.command_line import plain_config, usable_cores
from hashnerf.errors import UserError
from hashnerf.made_from import MADE_FROM, begin, digest, require_same
from hashnerf.run_lock import RunLock
from hashnerf.worker_processes import map_in_processes
from worlds.scenarios import world_from_description
from worlds.scene import World

LOCALISERS = ("baseline", "ours")
COLLECTING, TESTING = 1_000, 2_000
"""Added to a seed where a person drives to collect pictures, and to test a localiser."""


def town_of(config: AerialConfig, survey: Survey) -> World:
    """Returns the embedded world behind a data set; raises UserError where there is none."""
    description = survey.data.extras.get("world")
    if description is None:
        raise UserError(f"{config.dataset}: was not rendered from an embedded world, so nobody can drive in it")
    return world_from_description(description)


def origin_of(survey: Survey) -> tuple[float, float]:
    """Returns what loading subtracted from positions on the ground, metres."""
    return float(survey.data.origin[0]), float(survey.data.origin[1])


def run_drives(config: AerialConfig) -> None:
    """A person drives every trajectory in the town as it is now and collects pictures."""
    survey = load_driven_survey(config)
    town_of(config, survey)
    with RunLock(config.folder):
        whole = (config.drives / "transforms.json").is_file() and not config.overwrite
        begin(config.drives, _drives_record(config), overwrite=not whole)
        if whole:
            return
        names = list(survey.trajectories)
        for _ in map_in_processes(_Collector(config), names, config.workers or usable_cores()):
            pass
        extras = {key: survey.data.extras[key] for key in ("road_network", "trajectories")}
        join_views(config.drives, names, extras)


def _drives_record(config: AerialConfig) -> dict:
    plain = plain_config(config)
    person = {key: plain["teleoperation"][key] for key in ("laps", "hand", "hand_seconds")}
    parts = {key: plain[key] for key in ("seed", "camera", "car", "pure_pursuit", "drive", "deployment")}
    return parts | {"teleoperation": person, "dataset": digest(FilePath(config.dataset) / "transforms.json")}


@dataclass(frozen=True)
class _Collector:
    """Collects the pictures of one trajectory."""

    config: AerialConfig

    def __call__(self) -> Callable[[str], None]:
        survey = load_driven_survey(replace(self.config, threads=1))
        town, origin = town_of(self.config, survey), np.array([*origin_of(survey), 0.0])

        def collect(name: str) -> None:
            path = survey.trajectories[name]
            seed, laps = self.config.seed + COLLECTING, self.config.teleoperation.laps
            person, _ = teleoperate(self.config, town, survey, path, seed, laps, np.random.default_rng([seed, 3]))
            car = GroundPoses(
                np.stack(person.poses) + origin,
                np.zeros((len(person.poses), 2)),
                np.array([path.nearest(pose[:2])[0] for pose in person.poses]),
            )
            folder = self.config.drives / name
            for index, picture in enumerate(person.pictures):
                write_view(folder, index, picture[..., :3], depth_of(picture, self.config.camera.depth_range))
            height = survey.network.height + float(survey.data.origin[2])
            box = survey.data.scene_box + survey.data.origin.float()
            cameras = cameras_of(self.config.camera, car, height)
            describe_views(cameras, car, np.array(person.wanted), folder, box, {})

        return collect


def teleoperate(
    config: AerialConfig, town: World, survey: Survey, path: Path, seed: int, laps: int, rng: np.random.Generator
) -> tuple[Teleoperator, Drive]:
    """A person drives some laps; returns what was seen, and the drive.

    Who drives by hand and strays steers back: nobody lifts the car, unless it has touched something.
    """
    config = replace(config, drive=replace(config.drive, intervention=math.inf))
    person = Teleoperator(path, config.pure_pursuit, config.teleoperation, config.drive.tick, rng)
    return person, drive_in(config, town, origin_of(survey), person, path, seed, laps)


def sources_of(config: AerialConfig, method: str, trajectory: str) -> list[FilePath]:
    """Returns the folders of what a method learns from along one trajectory."""
    drives, drone, augmented = config.drives, config.folder / "ground", from_drives(config).folder / "ground"
    sources = {
        "baseline": (drives,),
        "imit": (drives,),
        "imit_gv": (drives, augmented),
        "ours": (drone,),
        "ours_gv": (drone, drives, augmented),
    }
    return [source / trajectory for source in sources[method]]


def pictures_of(config: AerialConfig, method: str, trajectory: str) -> list[GroundViews]:
    """Returns what a method learns from along one trajectory."""
    return [load_views(folder) for folder in sources_of(config, method, trajectory)]


def _pictures_digest(config: AerialConfig, method: str, trajectories: Iterable[str]) -> str:
    folders = [folder for name in trajectories for folder in sources_of(config, method, name)]
    return digest(*(folder / file for folder in folders for file in ("transforms.json", MADE_FROM)))


def seen(config: AerialConfig, views: GroundViews, network: NetworkConfig) -> UInt8[Tensor, "n h w c"]:
    """Returns pictures as a network reads them: with depth where it asks for it."""
    return views.rgbd(config.camera.depth_range) if network.depth else views.pictures


def methods_of(config: AerialConfig, wanted: Sequence[str]) -> list[str]:
    """Returns the methods for which there are pictures: without collected drives, `ours` alone."""
    return [method for method in wanted if method == "ours" or (config.drives / "transforms.json").is_file()]


def policy_folder(config: AerialConfig, trajectory: str, method: str, seed: int) -> FilePath:
    """Where a steering network is kept."""
    return config.folder / "policies" / trajectory / method / str(seed)


def localiser_folder(config: AerialConfig, method: str, seed: int) -> FilePath:
    """Where a localiser is kept."""
    return config.folder / "localisers" / method / str(seed)


def run_policies(config: AerialConfig, on_network: Callable[[int, int], None] = lambda done, total: None) -> None:
    """A steering network for every trajectory, method and seed."""
    survey = load_driven_survey(config)
    jobs = [
        (policy_folder(config, trajectory, method, seed), trajectory, method, seed)
        for trajectory in survey.trajectories
        for method in methods_of(config, METHODS)
        for seed in range(config.seeds)
    ]
    _train_missing(config, config.folder / "policies", _PolicyTrainer(config), jobs, on_network)


@dataclass(frozen=True)
class _PolicyTrainer:
    config: AerialConfig

    def __call__(self) -> Callable[[tuple[FilePath, str, str, int]], None]:
        imitation, limit = self.config.imitation, self.config.car.steering_limit

        def train(job: tuple[FilePath, str, str, int]) -> None:
            folder, trajectory, method, seed = job
            views = pictures_of(self.config, method, trajectory)
            number = self.config.seed * 101 + seed
            pictures = [seen(self.config, part, imitation.task.network) for part in views]
            wanted = [part.steering for part in views]
            skies = [part.sky for part in views]
            network = train_policy(pictures, wanted, imitation.task, limit, number, skies)
            save_network(folder, network, self.record(job))

        return train

    def record(self, job: tuple[FilePath, str, str, int]) -> dict:
        """What a network is made from."""
        _, trajectory, method, _ = job
        about = {"seed": self.config.seed, "imitation.task": plain_config(self.config.imitation.task)}
        about |= {"car.steering_limit": self.config.car.steering_limit}
        return about | {"pictures": _pictures_digest(self.config, method, [trajectory])}


def run_localisers(config: AerialConfig, on_network: Callable[[int, int], None] = lambda done, total: None) -> None:
    """A localiser for every method and seed, from the pictures of all trajectories."""
    survey = load_driven_survey(config)
    jobs = [
        (localiser_folder(config, method, seed), method, seed)
        for method in methods_of(config, LOCALISERS)
        for seed in range(config.seeds)
    ]
    trainer = _LocaliserTrainer(config, tuple(survey.trajectories))
    _train_missing(config, config.folder / "localisers", trainer, jobs, on_network)


@dataclass(frozen=True)
class _LocaliserTrainer:
    config: AerialConfig
    trajectories: tuple[str, ...]

    def __call__(self) -> Callable[[tuple[FilePath, str, int]], None]:
        task = self.config.localisation.task

        def train(job: tuple[FilePath, str, int]) -> None:
            folder, method, seed = job
            views = [part for name in self.trajectories for part in pictures_of(self.config, method, name)]
            number = self.config.seed * 101 + seed
            pictures, poses = [seen(self.config, part, task.network) for part in views], [part.poses for part in views]
            skies, loss = [part.sky for part in views], self.config.localisation.loss
            localiser = train_localiser(pictures, poses, task, number, skies, loss)
            save_localiser(folder, localiser, self.record(job))

        return train

    def record(self, job: tuple[FilePath, str, int]) -> dict:
        """What a network is made from."""
        _, method, _ = job
        about = {"seed": self.config.seed, "localisation": plain_config(self.config.localisation)}
        return about | {"pictures": _pictures_digest(self.config, method, self.trajectories)}


def _train_missing(
    config: AerialConfig,
    folder: FilePath,
    trainer: _PolicyTrainer | _LocaliserTrainer,
    jobs: list[tuple],
    on_network: Callable[[int, int], None],
) -> None:
    with RunLock(folder):
        missing = [job for job in jobs if config.overwrite or not _is_made(job[0], trainer.record(job))]
        done = len(jobs) - len(missing)
        on_network(done, len(jobs))
        for _ in map_in_processes(trainer, missing, config.workers or usable_cores()):
            done += 1
            on_network(done, len(jobs))


def _is_made(folder: FilePath, record: dict) -> bool:
    """Whether a whole network is there; raises UserError for one that was made from something else."""
    try:
        about = load_checkpoint(folder).state
    except UserError:  # none, or a damaged one, which training replaces
        return False
    require_same(folder, about.get("made_from", {}), record)
    return True


def is_trained(folder: FilePath) -> bool:
    """Whether a network was saved here."""
    return (folder / f"{0:07d}").is_dir()


def save_network(folder: FilePath, network: PictureNetwork, made_from: Mapping) -> None:
    """Saves a network with the size of its pictures and what it was made from."""
    about = {"height": network.height, "width": network.width, "outputs": network.head[-1].out_features}
    about |= {"made_from": dict(made_from)}
    save_checkpoint(folder, 0, module_tensors(network, "network"), about, keep=1)


def load_network(folder: FilePath, config: NetworkConfig) -> PictureNetwork:
    """Loads a network; raises UserError where there is none."""
    if not is_trained(folder):
        raise UserError(f"{folder}: no trained network here; run scripts/train_policy.py first")
    _, tensors, about = load_checkpoint(folder)
    network = PictureNetwork(config, about["height"], about["width"], about["outputs"])
    load_module_state(network, tensors, "network")
    return network.eval()
