"""From a data-set folder to ground views; each stage is resumable and does nothing when it is finished.

runs/<name>/{config.yaml, reconstruction/, ground/<trajectory>/}.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path as FilePath

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from aerial2ground.config import AerialConfig
from aerial2ground.ground_poses import GroundPoses, disturbed_poses
from aerial2ground.ground_truth import TrueTown
from aerial2ground.ground_views import Renderer, cameras_of, describe_views, nerf_renderer, render_views
from aerial2ground.imitation import expert_steering
from aerial2ground.paths import Path
from aerial2ground.pure_pursuit import require_followable
from aerial2ground.reconstruction import RoadNerf, train_road_nerf
from aerial2ground.road_network import RoadNetwork, read_road_file, read_road_network
from aerial2ground.trajectories import read_trajectories
from hashnerf.cameras import Cameras, project
from hashnerf.capacity import filled_from, with_capacity
from hashnerf.command_line import plain_config, save_config, set_threads, usable_cores
from hashnerf.errors import UserError
from hashnerf.made_from import begin, digest
from hashnerf.model_files import load_model, weights_digest
from hashnerf.posed_images import PosedImages, load_posed_images
from hashnerf.random_state import seed_everything
from hashnerf.run_lock import RunLock
from hashnerf.training_run import begun_config

CONFIG = "config.yaml"
FEWEST_PICTURES = 8
VIEWING = ("view_samples_per_opacity", "view_parts", "view_supersample")
"""What of a reconstruction's settings may change after training: how its views are rendered."""


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
    """Loads the data set; raises UserError where it is not enough to reconstruct a town with roads.

    A reconstruction needs no trajectories: without any, `trajectories` is empty.
    """
    set_threads(config.threads)
    seed_everything(config.seed)
    folder = FilePath(config.dataset)
    source = str(folder / "transforms.json")
    data = load_posed_images(folder, config.image_size or None)
    data = data.with_test_every(config.test_every).with_scene_box(config.scene_box)
    network = _road_network(config, data, source)
    trajectories = {}
    if data.extras.get("trajectories") is not None:
        trajectories = read_trajectories(data.extras["trajectories"], network, data.origin, source)
    for path in trajectories.values():
        require_followable(path, config.pure_pursuit)
    survey = Survey(data, network, trajectories)
    count = sum(frame.split == "train" for frame in data.frames)
    if count < FEWEST_PICTURES:
        raise UserError(
            f"{folder}: has {count} training pictures, too few for a radiance field; take at least {FEWEST_PICTURES}"
        )
    unseen = unseen_road(survey.train.cameras, network, data.scene_box)
    if unseen == 1.0:
        raise UserError(
            f"{folder}: no picture shows any of the road network within the scene's box; "
            "its lines must be metres in the frame of the poses"
        )
    return survey


def load_driven_survey(config: AerialConfig) -> Survey:
    """Loads a data set to be driven in; raises UserError also for one without trajectories."""
    survey = load_survey(config)
    if not survey.trajectories:
        source = FilePath(config.dataset) / "transforms.json"
        raise UserError(f"{source}: has no trajectories; add the paths to be driven, name -> [[x, y], ...]")
    return survey


def _road_network(config: AerialConfig, data: PosedImages, source: str) -> RoadNetwork:
    entry = data.extras.get("road_network")
    if not config.road_network:
        return read_road_network(entry, data.origin, source)
    if entry is not None:
        raise UserError(f"{source}: has a road_network of its own; leave road_network ({config.road_network}) empty")
    return read_road_network(read_road_file(FilePath(config.road_network)), data.origin, config.road_network)


def unseen_road(cameras: Cameras, network: RoadNetwork, box: Float[Tensor, "2 3"]) -> float:
    """Returns the share of the roads' surface that lies outside all pictures, or beside the box of the scene.

    A picture that shows the horizon shows what is any distance away.
    """
    points, _ = network.sample(500, torch.Generator().manual_seed(0))
    inside = ((points >= box[0]) & (points <= box[1]))[:, :2].all(dim=1)
    seen = torch.zeros(len(points), dtype=torch.bool)
    for index in range(len(cameras)):
        pixel, _ = project(cameras, torch.full((len(points),), index), points)
        seen |= ((pixel >= 0) & (pixel < torch.tensor([cameras.width, cameras.height]))).all(dim=1)
    return float((~(seen & inside)).float().mean())


def run_reconstruction(config: AerialConfig) -> None:
    """Stage 1."""
    survey = load_survey(config)
    config.folder.mkdir(parents=True, exist_ok=True)
    train = survey.train
    begun = begun_config(config.folder / "reconstruction", config.overwrite)
    full = with_capacity(
        config.reconstruction,
        begun and begun["reconstruction"],
        train.images,
        train.cameras,
        survey.data.scene_box,
    )
    config = replace(config, reconstruction=full)
    nerf = new_nerf(config, survey.data.scene_box, len(train))
    record = {key: plain_config(config)[key] for key in ("dataset", "image_size", "seed", "reconstruction")}
    for key in VIEWING:
        del record["reconstruction"][key]
    folder = config.folder / "reconstruction"
    settings = config.reconstruction
    train_road_nerf(
        replace(settings, fit=replace(settings.fit, seed=config.seed)),
        nerf,
        train,
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
    begun = begun_config(folder)
    if begun is not None:
        config = replace(config, reconstruction=filled_from(config.reconstruction, begun["reconstruction"]))
    nerf, cost = load_model(folder, lambda _: new_nerf(config, scene_box, cameras), "scripts/train_road_nerf.py")
    return nerf.eval(), cost


@dataclass(frozen=True)
class SavedField:
    """Loads the renderer of a run's radiance field; small enough to be sent to another process."""

    config: AerialConfig
    scene_box: Float[Tensor, "2 3"]
    cameras: int
    pixels: int
    """About how many pixels will be rendered."""

    def __call__(self) -> Renderer:
        """Returns the renderer."""
        nerf, _ = _load_nerf(self.config, self.scene_box, self.cameras)
        nerf.bake(self.pixels)
        return nerf_renderer(nerf)


def run_ground_views(
    config: AerialConfig, on_view: Callable[[int, int], None] = lambda done, total: None, of_truth: bool = False
) -> None:
    """Stage 2: disturbed ground views along every trajectory, with what the expert would steer.

    They are views of the run's field, or `of_truth` pictures of the embedded world behind the data set: what a perfect
    field would show. Raises UserError where there is no such world.
    """
    survey = load_driven_survey(config)
    wanted = {name: _disturbed_views(config, survey, name) for name in survey.trajectories}
    sets = [(cameras, config.folder / "ground" / name) for name, (_, cameras) in wanted.items()]
    workers = config.workers or usable_cores()
    pixels = sum(len(cameras) for cameras, _ in sets) * config.camera.width * config.camera.height // workers
    renderer: Callable[[], Renderer] = SavedField(config, survey.data.scene_box, len(survey.train.images), pixels)
    if of_truth:
        description = survey.data.extras.get("world")
        if description is None:
            raise UserError(f"{config.dataset}: was not rendered from an embedded world; leave --of_truth out")
        renderer = TrueTown(description, survey.data.origin)
    with RunLock(config.folder / "ground"):
        for name, (_, folder) in zip(wanted, sets):
            begin(folder, _made_from(config, survey, name, of_truth), config.overwrite)
        render_views(renderer, sets, workers, on_view)
        for (name, (car, cameras)), (_, folder) in zip(wanted.items(), sets):
            steering = expert_steering(survey.trajectories[name], car, config.pure_pursuit)
            describe_views(cameras, car, steering, folder, survey.data.scene_box, {})


def _made_from(config: AerialConfig, survey: Survey, name: str, of_truth: bool) -> dict:
    plain = plain_config(config)
    if of_truth:
        source = {"truth": digest(FilePath(config.dataset) / "transforms.json")}
    else:
        views = {key: plain["reconstruction"][key] for key in VIEWING}
        source = {"reconstruction": views | {"weights": weights_digest(config.folder / "reconstruction")}}
    return {
        "seed": config.seed,
        "imitation": {key: plain["imitation"][key] for key in ("views", "disturbance")},
        "camera": plain["camera"],
        "path": digest(survey.trajectories[name].points.tobytes()),
    } | source


def _disturbed_views(config: AerialConfig, survey: Survey, name: str) -> tuple[GroundPoses, Cameras]:
    rng = np.random.default_rng([config.seed, list(survey.trajectories).index(name)])
    car = disturbed_poses(survey.trajectories[name], config.imitation.views, config.imitation.disturbance, rng)
    return car, cameras_of(config.camera, car, survey.network.heights_at(torch.from_numpy(car.poses[:, :2])))
