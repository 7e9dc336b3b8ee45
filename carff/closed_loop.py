"""Closed-loop episodes in an embedded world: what the ego's camera sees decides, again and again, until it has crossed.

All episodes of a policy advance together, so that pictures are encoded and futures probed in batches. A policy maps
(drives, their numbers) to one command each: True for go. Policies that do not look are functions of the drive alone.
"""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from carff.driving import (
    Drive,
    DrivingConfig,
    actor_poses,
    advance,
    begin,
    can_stop,
    draw_setup,
    going_is_safe,
    stop_matters,
)
from carff.model import CarffModel
from carff.planner import PlannerConfig, decide
from carff.planning_metrics import Episode
from worlds.scenarios import world_from_description
from worlds.scene import Scene, World, ego_camera

Policy = Callable[[list[Drive]], list[bool]]


@dataclass(frozen=True)
class Camera:
    """Renders what the ego sees; `description` is the data set's `world` entry."""

    description: dict
    width: int
    height: int

    def picture(self, drive: Drive) -> np.ndarray:
        """Returns the uint8 picture [h, w, 3] from the ego's camera at a moment."""
        world = world_from_description(self.description)
        camera = ego_camera(world, world.traffic.routes["ego"].pose(drive.s)).scaled(self.width, self.height)
        return Scene(world, actor_poses(world, drive.setup, drive.time)).render(camera).rgb


class SeeingPolicy:
    """Decides from the ego camera's picture: encode, forecast n futures, probe, apply the planner's rule."""

    def __init__(
        self, model: CarffModel, camera: Camera, planner: PlannerConfig, n: int, seed: int, pool: ProcessPoolExecutor
    ):
        self.model, self.camera, self.planner, self.n, self.pool = model, camera, planner, n, pool
        self.generator = torch.Generator().manual_seed(seed)

    def __call__(self, drives: list[Drive]) -> list[bool]:
        """Returns go or stop for each drive."""
        pictures = list(self.pool.map(self.camera.picture, drives, chunksize=4))
        return self.decide(torch.from_numpy(np.stack(pictures)))

    def decide(self, pictures: UInt8[Tensor, "images h w 3"]) -> list[bool]:
        """Returns go or stop for each picture."""
        belief = self.model.encode(pictures)
        latents = self.model.mdn(belief.mean, belief.logvar).sample(self.n, self.generator)
        states = self.model.probe_latents(latents.flatten(0, 1)).reshape(len(pictures), self.n)
        return [decide(*self.model.hazards(row), self.planner).go for row in states]


def drive_episodes(world: World, policy: Policy, setups: list, config: DrivingConfig) -> tuple[list[Drive], list[int]]:
    """Drives every episode to its end; returns the last moments and the number of decisions each took."""
    drives = [begin(setup) for setup in setups]
    go, decisions = [True] * len(drives), [0] * len(drives)
    for tick in range(round(config.longest / config.tick)):
        if tick % config.decision_ticks == 0:
            open_ = [i for i, drive in enumerate(drives) if not drive.over and stop_matters(world, drive, config)]
            for i, command in zip(open_, policy([drives[i] for i in open_]) if open_ else []):
                go[i] = command
                decisions[i] += 1
        drives = [
            d if d.over else advance(world, d, go[i] or not can_stop(world, d, config), config)
            for i, d in enumerate(drives)
        ]
        if all(drive.over for drive in drives):
            break
    return drives, decisions


def closed_loop(
    model: CarffModel, description: dict, episodes: int, n: int, config: DrivingConfig, seed: int, workers: int
) -> list[Episode]:
    """Drives the same random episodes with the planner's rules, the two baselines and the all-seeing oracle."""
    world = world_from_description(description)
    rng = np.random.default_rng(seed)
    setups = [draw_setup(world, config, rng) for _ in range(episodes)]
    camera = Camera(description, model.scene.cameras.width, model.scene.cameras.height)
    blind: dict[str, Policy] = {
        "always_stop": lambda drives: [False] * len(drives),
        "always_go": lambda drives: [True] * len(drives),
        "oracle": lambda drives: [going_is_safe(world, drive, config) for drive in drives],
    }
    runs = {name: drive_episodes(world, policy, setups, config) for name, policy in blind.items()}
    # A fresh interpreter per worker: forking a process whose tensor threads are running can hang.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for rule in ("risk", "paper"):
            planner = PlannerConfig(**{**vars(model.config.planner), "rule": rule})
            policy = SeeingPolicy(model, camera, planner, n, seed, pool)
            runs[rule] = drive_episodes(world, policy, setups, config)
    oracle, _ = runs["oracle"]
    ungoverned, _ = runs["always_go"]
    hazard = [drive.collided for drive in ungoverned]
    return [
        Episode(
            policy=name,
            branch=drive.setup.branch,
            hazard=hazard[i],
            collided=drive.collided,
            stopped=drive.stood,
            needless_stop=drive.stood and not oracle[i].stood,
            time_to_cross=drive.crossed,
            decisions=decisions[i],
        )
        for name, (drives, decisions) in runs.items()
        for i, drive in enumerate(drives)
    ]
