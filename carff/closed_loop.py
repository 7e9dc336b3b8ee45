"""Closed-loop episodes in an embedded world: what the ego's camera sees decides, again and again, until it has crossed.

All episodes of a policy advance together, so that pictures are encoded and futures probed in batches. A policy maps
drives and their numbers to one command each: True for go. Policies that do not look are functions of the drive alone.
"""

import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from carff.approach import decide_along_approach
from carff.closed_loop_file import ClosedLoop, save_closed_loop
from carff.decisions import decide_from_pictures
from carff.driving import (
    Drive,
    DrivingConfig,
    advance,
    begin,
    draw_setup,
    going_is_safe,
    stop_matters,
)
from carff.ego_pictures import Camera, Look, remembering
from carff.model import CarffModel, load_carff
from carff.planner import PlannerConfig
from carff.planning_metrics import ALWAYS_GO, ALWAYS_STOP, ApproachPoint, Episode
from carff.state_memory import StateMemory, state_transitions
from hashnerf.command_line import usable_cores
from hashnerf.errors import UserError
from hashnerf.worker_processes import worker_processes
from worlds.scenarios import world_from_description
from worlds.scene import World

Policy = Callable[[list[Drive], list[int]], list[bool]]


class SeeingPolicy:
    """Decides from the ego camera's pictures: encode, forecast n futures, probe, remember, apply the planner's rule.

    `look` renders what the cameras of some drives see, [drives, h, w, 3].
    """

    def __init__(self, model: CarffModel, look: Look, planner: PlannerConfig, n: int, seed: int, step_seconds: float):
        self.model, self.look, self.planner, self.n = model, look, planner, n
        self.generator = torch.Generator().manual_seed(seed)
        self.transitions, self.step_seconds = state_transitions(model, self.generator), step_seconds
        self.memories: dict[int, StateMemory] = {}

    def __call__(self, drives: list[Drive], numbers: list[int]) -> list[bool]:
        """Returns go or stop for each drive."""
        same = self.model.probe.candidates.same
        for number in numbers:
            self.memories.setdefault(number, StateMemory(self.transitions, same, self.step_seconds))

        def rule_out(place: int, posterior: Tensor) -> Tensor:
            return self.memories[numbers[place]].rule_out(drives[place].time, posterior)

        pictures = self.look(drives)
        decisions = decide_from_pictures(self.model, pictures, self.planner, self.n, self.generator, rule_out)
        return [one.go for one in decisions]


def drive_episodes(world: World, policy: Policy, setups: list, config: DrivingConfig) -> tuple[list[Drive], list[int]]:
    """Drives every episode to its end; returns the last moments and the number of decisions each took."""
    drives = [begin(setup) for setup in setups]
    go, decisions = [True] * len(drives), [0] * len(drives)
    for tick in range(round(config.longest / config.tick)):
        if tick % config.decision_ticks == 0:
            open_ = [i for i, drive in enumerate(drives) if not drive.over and stop_matters(world, drive, config)]
            for i, command in zip(open_, policy([drives[i] for i in open_], open_) if open_ else []):
                go[i] = command
                decisions[i] += 1
        drives = [d if d.over else advance(world, d, go[i], config) for i, d in enumerate(drives)]
        if all(drive.over for drive in drives):
            break
    return drives, decisions


def closed_loop(
    model: CarffModel, description: dict, episodes: int, n: int, config: DrivingConfig, seed: int, workers: int
) -> tuple[list[Episode], list[ApproachPoint]]:
    """Drives the same random episodes with the planner's rules, the two baselines and the all-seeing oracle.

    Beside them come the decisions along the approach, from single pictures.
    """
    world = world_from_description(description)
    rng = np.random.default_rng(seed)
    setups = [draw_setup(world, config, rng) for _ in range(episodes)]
    camera = Camera(description, model.scene.cameras.width, model.scene.cameras.height)
    blind: dict[str, Policy] = {
        ALWAYS_STOP: lambda drives, _: [False] * len(drives),
        ALWAYS_GO: lambda drives, _: [True] * len(drives),
        "oracle": lambda drives, _: [going_is_safe(world, drive, config) for drive in drives],
    }
    runs = {name: drive_episodes(world, policy, setups, config) for name, policy in blind.items()}
    with worker_processes(camera.renderer, workers) as pictures:
        look = remembering(world, lambda drives: list(pictures(drives)))
        for rule in ("risk", "paper"):
            planner = replace(model.config.planner, rule=rule)
            policy = SeeingPolicy(model, look, planner, n, seed, world.traffic.step_seconds)
            runs[rule] = drive_episodes(world, policy, setups, config)
        points = decide_along_approach(model, world, look, n, config, seed)
    return compared(runs), points


def compared(runs: dict[str, tuple[list[Drive], list[int]]]) -> list[Episode]:
    """Judges every policy's drives beside those of the oracle and of the one that always goes, setup by setup."""
    oracle, _ = runs["oracle"]
    ungoverned, _ = runs[ALWAYS_GO]
    return [
        Episode(
            policy=name,
            branch=drive.setup.branch,
            hazard=ungoverned[i].collided,
            collided=drive.collided,
            stopped=drive.stood,
            needless_stop=drive.stood and not oracle[i].stood,
            time_to_cross=drive.crossed,
            decisions=decisions[i],
        )
        for name, (drives, decisions) in runs.items()
        for i, drive in enumerate(drives)
    ]


def drive_run(folder: Path, episodes: int, n: int, config: DrivingConfig, seed: int, workers: int = 0) -> ClosedLoop:
    """Drives a trained run in the embedded world it was rendered from and writes closed_loop.json beside it.

    `workers` processes render pictures, 0 means one per core. A world in which the ego never moves gives no episodes
    but a reason. Raises UserError for a run whose data set does not come from an embedded world.
    """
    model = load_carff(folder)
    description = model.scene.world
    if description is None:
        raise UserError(f"{folder}: its data set was not rendered from an embedded world, so it cannot be driven in")
    reason = undrivable(world_from_description(description))
    start = time.monotonic()
    driven, points = [], []
    if not reason:
        driven, points = closed_loop(model, description, episodes, n, config, seed, workers or usable_cores())
    about = {"samples": n, "seed": seed, "seconds": round(time.monotonic() - start, 2), "driving": asdict(config)}
    recorded = ClosedLoop(tuple(driven), tuple(points), about, reason)
    save_closed_loop(folder, recorded)
    return recorded


def undrivable(world: World) -> str:
    """Returns why there is nothing to drive in a world, or an empty text."""
    if world.traffic is None:
        return f"nothing drives in {world.scenario}"
    if min(speed for (_, name), speed in world.traffic.speeds.items() if name == "ego") <= 0:
        return f"the ego stands still in {world.scenario}: it has no crossing to decide about"
    return ""
