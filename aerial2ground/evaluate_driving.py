"""Driving in the deployment town (Table II): every trajectory, method and seed, several at a time.

Positions are those of the loaded data set; the town's own differ by the origin that loading subtracted.
"""

import json
import multiprocessing
import signal
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import torch

from aerial2ground.car import CarState
from aerial2ground.config import AerialConfig
from aerial2ground.deployment import Deployment
from aerial2ground.driving import Drive, drive
from aerial2ground.imitation import expert_policy, network_policy
from aerial2ground.networks import PictureNetwork
from aerial2ground.paths import Path
from hashnerf.transforms_json import write_atomically
from worlds.scenarios import world_from_description

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
    if workers == 1:
        runner = _Runner(config, description, origin)
        return [runner(trial) for trial in trials]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, _start, (config, description, origin)) as pool:
        return list(pool.map(_work, trials))


class _Runner:
    """Drives trials in one process."""

    def __init__(self, config: AerialConfig, description: Mapping, origin: tuple[float, float]):
        self.config, self.origin = config, origin
        self.town = world_from_description(description)

    def __call__(self, trial: Trial) -> Drive:
        config, (east, north) = self.config, self.origin
        town = Deployment(self.town, config.deployment, config.camera, config.car, trial.seed)
        limit = config.car.steering_limit
        policy = (
            expert_policy(trial.path, config.pure_pursuit)
            if trial.network is None
            else network_policy(trial.network.eval(), limit)
        )

        def look(state: CarState) -> np.ndarray:
            return town.look(replace(state, x=state.x + east, y=state.y + north))

        def touches(corners: np.ndarray) -> bool:
            return town.touches(corners + np.array(self.origin))

        rng = np.random.default_rng([trial.seed, len(trial.trajectory)])
        return drive(policy, look, touches, trial.path, config.drive, config.car, config.pure_pursuit, rng)


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
    """Writes driving.json: the table and every track."""
    tracks = [
        {
            "trajectory": trial.trajectory,
            "method": trial.method,
            "seed": trial.seed,
            "track": one.track.round(3).tolist(),
        }
        for trial, one in zip(trials, drives)
    ]
    document = {"table2": table_two(trials, drives), "tracks": tracks}
    write_atomically(config.folder / "driving.json", json.dumps(document, allow_nan=False).encode())


_runner: _Runner | None = None


def _start(config: AerialConfig, description: Mapping, origin: tuple[float, float]) -> None:
    global _runner
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    torch.set_num_threads(1)
    _runner = _Runner(config, description, origin)


def _work(trial: Trial) -> Drive:
    assert _runner is not None
    return _runner(trial)
