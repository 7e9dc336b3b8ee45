"""What the networks are worth in the town as it is now: Table II (driving.json) and Table I (localisation.json)."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from aerial2ground.config import AerialConfig
from aerial2ground.evaluate_driving import EXPERT, Trial, drive_trials, save_drives, table_two
from aerial2ground.imitation import METHODS, network_answer
from aerial2ground.latency import latency_ms
from aerial2ground.learning_stages import (
    LOCALISERS,
    TESTING,
    load_network,
    localiser_folder,
    methods_of,
    origin_of,
    policy_folder,
    teleoperate,
    town_of,
)
from aerial2ground.localisation import load_localiser, pose_distances, pose_rmse
from aerial2ground.networks import PictureNetwork
from aerial2ground.pose_tracker import filtered_poses
from aerial2ground.stages import load_driven_survey
from hashnerf.command_line import usable_cores
from hashnerf.transforms_json import write_atomically
from hashnerf.worker_processes import map_in_processes
from worlds.inertial import Readings, measure


def run_driving(config: AerialConfig) -> dict:
    """The networks and the expert drive in the deployment town; returns Table II.

    Raises UserError for a data set that was not rendered from an embedded world.
    """
    survey = load_driven_survey(config)
    town_of(config, survey)
    task, trials = config.imitation.task.network, []
    for name, path in survey.trajectories.items():
        for seed in range(config.seeds):
            trials.append(Trial(name, EXPERT, seed, path, None))
            for method in methods_of(config, METHODS):
                network = load_network(policy_folder(config, name, method, seed), task)
                trials.append(Trial(name, method, seed, path, network))
    world = survey.data.extras["world"]
    drives = drive_trials(config, world, origin_of(survey), trials, config.workers or usable_cores())
    save_drives(config, trials, drives)
    save_latency(config, next(trial.network for trial in trials if trial.network is not None))
    return table_two(trials, drives)


def save_latency(config: AerialConfig, network: PictureNetwork) -> None:
    """Times a steering network for one picture on one thread and writes latency.json."""
    channels = 4 if network.config.depth else 3
    picture = np.random.default_rng(0).integers(0, 256, (network.height, network.width, channels), dtype=np.uint8)
    took = latency_ms(network_answer(network, config.car.steering_limit), picture)
    document = {"latency_ms_1thread": took.median, "p99_ms": took.p99}
    write_atomically(config.folder / "latency.json", json.dumps(document).encode())


@dataclass(frozen=True)
class TestDrive:
    """One lap of a person who is to be located; it ends where the car touches something and is lifted."""

    trajectory: str
    pictures: UInt8[Tensor, "n h w c"]
    times: Float[np.ndarray, " n"]
    poses: Float[np.ndarray, "n 3"]
    readings: Readings


@dataclass(frozen=True)
class _Tester:
    """Drives the laps of one trajectory; small enough to be sent to another process."""

    config: AerialConfig

    def __call__(self) -> Callable[[str], TestDrive]:
        config = replace(self.config, threads=1)
        survey = load_driven_survey(config)
        town = town_of(config, survey)

        def drive_once(name: str) -> TestDrive:
            seed, path = config.seed + TESTING, survey.trajectories[name]
            rng = np.random.default_rng([seed, 4])
            person, drive = teleoperate(config, town, survey, path, seed, 1, rng)
            # a car that was lifted has moved as no inertial sensor can tell
            moments, motions = drive.unbroken, drive.unbroken * config.drive.motion_ticks + 1
            readings = measure(drive.motion[:motions, 0], drive.motion[:motions, 1:], config.inertial, rng)
            pictures, poses = np.stack(person.pictures[:moments]), np.stack(person.poses[:moments])
            return TestDrive(name, torch.from_numpy(pictures), config.drive.tick * np.arange(moments), poses, readings)

        return drive_once


def test_drives(config: AerialConfig) -> list[TestDrive]:
    """A person drives a lap of every trajectory in the town as it is now."""
    survey = load_driven_survey(config)
    town_of(config, survey)
    return list(map_in_processes(_Tester(config), list(survey.trajectories), config.workers or usable_cores()))


def run_localisation(config: AerialConfig) -> dict:
    """A person drives a lap of every trajectory; returns Table I: how far the networks' poses are from the true ones.

    `ours_imu` is `ours` fused with the inertial sensor. Means over seeds of the root mean square over all pictures.
    """
    drives = test_drives(config)
    found: dict[str, list[list[np.ndarray]]] = {}
    for method in methods_of(config, LOCALISERS):
        for seed in range(config.seeds):
            localiser = load_localiser(localiser_folder(config, method, seed), config.localisation.task.network)
            told = [localiser.estimates(drive.pictures) for drive in drives]
            found.setdefault(method, []).append([one.poses for one in told])
            if method == "ours":
                fused = [
                    filtered_poses(drive.readings, drive.times, one.poses, config.pose_filter, one.deviations)
                    for drive, one in zip(drives, told)
                ]
                found.setdefault("ours_imu", []).append(fused)
    truth = [drive.poses for drive in drives]
    document = {
        "table1": {method: table_row(rows, truth) for method, rows in found.items()},
        "test_pictures": sum(len(poses) for poses in truth),
        "tracks": [
            {"trajectory": drive.trajectory, "truth": drive.poses.round(3).tolist()}
            | {method: rows[0][number].round(3).tolist() for method, rows in found.items()}
            for number, drive in enumerate(drives)
        ],
    }
    write_atomically(config.folder / "localisation.json", json.dumps(document, allow_nan=False).encode())
    return document["table1"]


def table_row(
    found: list[list[Float[np.ndarray, "_ 3"]]], truth: list[Float[np.ndarray, "_ 3"]]
) -> dict[str, float | int]:
    """Returns errors over all pictures, mean and spread over seeds; `found` holds a list of drives per seed."""
    errors = [pose_distances(np.concatenate(drives), np.concatenate(truth)) for drives in found]
    metres, degrees = np.array([pose_rmse(np.concatenate(drives), np.concatenate(truth)) for drives in found]).T
    return {
        "pos_m": float(metres.mean()),
        "pos_m_spread": float(metres.std()),
        "yaw_deg": float(degrees.mean()),
        "yaw_deg_spread": float(degrees.std()),
        "pos_m_median": float(np.mean([np.median(distance) for distance, _ in errors])),
        "yaw_deg_median": float(np.mean([np.median(angle) for _, angle in errors])),
        "runs": len(errors),
    }
