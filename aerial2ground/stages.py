"""The stages of aerial2ground on a data-set folder; each is resumable and does nothing when it is finished.

runs/<name>/{config.yaml, reconstruction/, ground/<trajectory>/, policies/<trajectory>/, driving.json}.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from aerial2ground.config import AerialConfig
from aerial2ground.evaluate_driving import EXPERT, Trial, drive_trials, save_drives, table_two
from aerial2ground.ground_poses import disturbed_poses
from aerial2ground.ground_views import Renderer, cameras_of, describe_views, load_views, nerf_renderer, render_views
from aerial2ground.imitation import expert_steering, train_policy
from aerial2ground.networks import NetworkConfig, PictureNetwork
from aerial2ground.paths import Path
from aerial2ground.pure_pursuit import require_followable
from aerial2ground.reconstruction import RoadNerf, train_road_nerf
from aerial2ground.road_network import RoadNetwork, read_road_network
from aerial2ground.trajectories import read_trajectories
from hashnerf.cameras import Cameras, project
from hashnerf.checkpoints import load_checkpoint, load_module_state, module_tensors, save_checkpoint
from hashnerf.command_line import plain_config, save_config, set_threads, usable_cores
from hashnerf.errors import UserError
from hashnerf.model_files import load_model
from hashnerf.posed_images import PosedImages, load_posed_images
from hashnerf.random_state import seed_everything

CONFIG = "config.yaml"
FEWEST_PICTURES = 8


@dataclass(frozen=True)
class Survey:
    """The drone's pictures and the roads below them."""

    data: PosedImages
    network: RoadNetwork
    trajectories: dict[str, Path]

    @property
    def train(self) -> PosedImages:
        """The pictures to learn from."""
        return self.data.split("train")

    @property
    def test(self) -> PosedImages:
        """The pictures held out."""
        return self.data.split("test")


def load_survey(config: AerialConfig) -> Survey:
    """Loads the data set; raises UserError where it is not enough to reconstruct a town with roads."""
    set_threads(config.threads)
    seed_everything(config.seed)
    folder = FilePath(config.dataset)
    data = load_posed_images(folder, config.image_size or None)
    network = read_road_network(data.extras.get("road_network"), data.origin, str(folder / "transforms.json"))
    source = str(folder / "transforms.json")
    trajectories = read_trajectories(data.extras.get("trajectories"), network, data.origin, source)
    for path in trajectories.values():
        require_followable(path, config.pure_pursuit)
    survey = Survey(data, network, trajectories)
    count = sum(frame.split == "train" for frame in data.frames)
    if count < FEWEST_PICTURES:
        raise UserError(
            f"{folder}: has {count} training pictures, too few for a radiance field; take at least {FEWEST_PICTURES}"
        )
    unseen = unseen_road(survey.train.cameras, network)
    if unseen == 1.0:
        raise UserError(
            f"{folder}: no picture shows any of the road network; its lines must be metres in the frame of the poses"
        )
    return survey


def unseen_road(cameras: Cameras, network: RoadNetwork) -> float:
    """Returns the share of the roads' surface that lies outside all pictures."""
    points, _ = network.sample(500, torch.Generator().manual_seed(0))
    seen = torch.zeros(len(points), dtype=torch.bool)
    for index in range(len(cameras)):
        pixel, _ = project(cameras, torch.full((len(points),), index), points)
        seen |= ((pixel >= 0) & (pixel < torch.tensor([cameras.width, cameras.height]))).all(dim=1)
    return float((~seen).float().mean())


def run_reconstruction(config: AerialConfig) -> None:
    """Stage 1."""
    survey = load_survey(config)
    config.folder.mkdir(parents=True, exist_ok=True)
    nerf = new_nerf(config, survey.data.scene_box, len(survey.train.images))
    record = {key: plain_config(config)[key] for key in ("dataset", "image_size", "seed", "reconstruction")}
    folder = config.folder / "reconstruction"
    settings = config.reconstruction
    train_road_nerf(
        replace(settings, fit=replace(settings.fit, seed=config.seed)),
        nerf,
        survey.train,
        survey.network,
        folder,
        record,
        config.overwrite,
    )
    save_config(config, config.folder / CONFIG)


def new_nerf(config: AerialConfig, scene_box: Float[Tensor, "2 3"], cameras: int) -> RoadNerf:
    """Builds an untrained radiance field."""
    torch.manual_seed(config.seed)
    return RoadNerf(config.reconstruction, scene_box, cameras)


def load_nerf(config: AerialConfig, survey: Survey) -> tuple[RoadNerf, dict]:
    """Loads the trained radiance field of a run and what its training cost."""
    return _load_nerf(config, survey.data.scene_box, len(survey.train))


def _load_nerf(config: AerialConfig, scene_box: Float[Tensor, "2 3"], cameras: int) -> tuple[RoadNerf, dict]:
    folder = config.folder / "reconstruction"
    nerf, cost = load_model(folder, lambda _: new_nerf(config, scene_box, cameras), "scripts/train_road_nerf.py")
    return nerf.eval(), cost


@dataclass(frozen=True)
class SavedField:
    """Loads the renderer of a run's radiance field; small enough to be sent to another process."""

    config: AerialConfig
    scene_box: Float[Tensor, "2 3"]
    cameras: int

    def __call__(self) -> Renderer:
        """Returns the renderer."""
        return nerf_renderer(_load_nerf(self.config, self.scene_box, self.cameras)[0])


def run_ground_views(config: AerialConfig, on_view: Callable[[int, int], None] = lambda done, total: None) -> None:
    """Stage 2: disturbed ground views along every trajectory, with what the expert would steer."""
    survey = load_survey(config)
    field = SavedField(config, survey.data.scene_box, len(survey.train.images))
    total = config.imitation.views * len(survey.trajectories)
    for number, (name, path) in enumerate(survey.trajectories.items()):
        car = disturbed_poses(
            path, config.imitation.views, config.imitation.disturbance, np.random.default_rng([config.seed, number])
        )
        cameras = cameras_of(config.camera, car, survey.network.height)
        folder, before = config.folder / "ground" / name, number * config.imitation.views
        workers = config.workers or usable_cores()
        render_views(field, cameras, folder, workers, lambda done, _, before=before: on_view(before + done, total))
        wanted = expert_steering(path, car, config.pure_pursuit)
        describe_views(cameras, car, wanted, folder, survey.data.scene_box, {})


def run_policies(config: AerialConfig) -> None:
    """Stage 3: a steering network for every trajectory, from ground views alone."""
    survey = load_survey(config)
    for number, name in enumerate(survey.trajectories):
        views = load_views(config.folder / "ground" / name)
        network = train_policy(
            [views.pictures],
            [views.steering],
            config.imitation.task,
            config.car.steering_limit,
            config.seed * 101 + number,
        )
        save_network(config.folder / "policies" / name, network)


def run_driving(config: AerialConfig, seeds: Sequence[int]) -> dict:
    """Stage 4: the networks and the expert drive in the deployment town; returns Table II.

    Raises UserError for a data set that was not rendered from an embedded world.
    """
    survey = load_survey(config)
    description = survey.data.extras.get("world")
    if description is None:
        raise UserError(f"{config.dataset}: was not rendered from an embedded world, so it cannot be driven in")
    trials = []
    for name, path in survey.trajectories.items():
        network = load_network(config.folder / "policies" / name, config.imitation.task.network)
        trials += [
            Trial(name, method, seed, path, one)
            for method, one in ((EXPERT, None), ("ours", network))
            for seed in seeds
        ]
    origin = (float(survey.data.origin[0]), float(survey.data.origin[1]))
    drives = drive_trials(config, description, origin, trials, config.workers or usable_cores())
    save_drives(config, trials, drives)
    return table_two(trials, drives)


def save_network(folder: FilePath, network: PictureNetwork) -> None:
    """Saves a network with the size of its pictures."""
    about = {"height": network.height, "width": network.width, "outputs": network.head[-1].out_features}
    save_checkpoint(folder, 0, module_tensors(network, "network"), about, keep=1)


def load_network(folder: FilePath, config: NetworkConfig) -> PictureNetwork:
    """Loads a network; raises UserError where there is none."""
    if not folder.is_dir():
        raise UserError(f"{folder}: no trained network here; run scripts/train_policy.py first")
    _, tensors, about = load_checkpoint(folder)
    network = PictureNetwork(config, about["height"], about["width"], about["outputs"])
    load_module_state(network, tensors, "network")
    return network.eval()
