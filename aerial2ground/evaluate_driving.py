"""Driving in the deployment town (Table II): every trajectory, method and seed, several at a time.

Positions are those of the loaded data set; the town's own differ by the origin that loading subtracted.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aerial2ground.config import AerialConfig
from aerial2ground.deployment import Deployment
from aerial2ground.driving import Drive, Policy, drive
from aerial2ground.imitation import expert_policy, network_policy
from aerial2ground.networks import PictureNetwork
from aerial2ground.paths import Path
from hashnerf.transforms_json import write_atomically
from hashnerf.worker_processes import map_in_processes
from worlds.scenarios import world_from_description
from worlds.scene import World

EXPERT = "expert"


@dataclass(frozen=True)
class Trial:
    """One drive to be made; `network` None is the expert."""

    trajectory: str
    method: str
    seed: int
    path: Path
    network: PictureNetwork | None


def drive_trials(
    config: AerialConfig, description: Mapping, origin: tuple[float, float], trials: Sequence[Trial], workers: int
) -> list[Drive]:
    """Drives every trial; results come in the order of `trials`."""
    return list(map_in_processes(_Runner(config, description, origin), trials, workers))


@dataclass(frozen=True)
class _Runner:
    """Drives trials; small enough to be sent to another process."""

    config: AerialConfig
    description: Mapping
    origin: tuple[float, float]

    def __call__(self) -> Callable[[Trial], Drive]:
        town = world_from_description(self.description)

        def run(trial: Trial) -> Drive:
            limit, pursuit = self.config.car.steering_limit, self.config.pure_pursuit
            network = trial.network
            policy = expert_policy(trial.path, pursuit) if network is None else network_policy(network.eval(), limit)
            return drive_in(self.config, town, self.origin, policy, trial.path, trial.seed, self.config.drive.laps)

        return run


def drive_in(
    config: AerialConfig, town: World, origin: tuple[float, float], policy: Policy, path: Path, seed: int, laps: int
) -> Drive:
    """Drives one policy along a path in the town as it is now; starts and noise depend on `seed` and path alone."""
    depth = config.imitation.task.network.depth or config.localisation.task.network.depth
    now = Deployment(town, config.deployment, config.camera, config.car, seed, origin, depth)
    rng = np.random.default_rng([seed, round(path.length * 1000)])
    settings = (replace(config.drive, laps=laps), config.car, config.pure_pursuit)
    return drive(policy, now.look, now.touches, now.obstacles - now.origin, path, *settings, rng)


def table_two(trials: Sequence[Trial], drives: Sequence[Drive]) -> dict:
    """Returns position and yaw error and interventions per run, over seeds, by trajectory and method."""
    table: dict = {}
    for key in dict.fromkeys((trial.trajectory, trial.method) for trial in trials):
        own = [one for trial, one in zip(trials, drives) if (trial.trajectory, trial.method) == key]
        metres, degrees = [one.position_rmse for one in own], [one.yaw_rmse for one in own]
        interventions = [one.interventions for one in own]
        table.setdefault(key[0], {})[key[1]] = {
            "pos_m": float(np.mean(metres)),
            "pos_m_spread": float(np.std(metres)),
            "yaw_deg": float(np.mean(degrees)),
            "yaw_deg_spread": float(np.std(degrees)),
            "interventions": float(np.mean(interventions)),
            "most_interventions": int(max(interventions)),
            "runs": len(own),
        }
    return table


def save_drives(config: AerialConfig, trials: Sequence[Trial], drives: Sequence[Drive]) -> None:
    """Writes driving.json: the table, the paths, every track with its errors, and where somebody intervened."""
    tracks = [
        {
            "trajectory": trial.trajectory,
            "method": trial.method,
            "seed": trial.seed,
            "track": one.track.round(3).tolist(),
            "lateral": one.lateral.round(4).tolist(),
            "heading": one.heading.round(4).tolist(),
            "put_back": one.put_back.round(3).tolist(),
        }
        for trial, one in zip(trials, drives)
    ]
    paths = {trial.trajectory: trial.path.points.round(3).tolist() for trial in trials}
    document = {"table2": table_two(trials, drives), "paths": paths, "tracks": tracks}
    write_atomically(config.folder / "driving.json", json.dumps(document, allow_nan=False).encode())
