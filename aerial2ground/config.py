"""The config of the aerial2ground pipeline: one file for all stages."""

from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Literal

from aerial2ground.car import CarConfig
from aerial2ground.car_camera import CarCameraConfig
from aerial2ground.deployment import DeploymentConfig
from aerial2ground.driving import DriveConfig
from aerial2ground.imitation import ImitationConfig
from aerial2ground.localisation import LocalisationConfig
from aerial2ground.pose_filter import PoseFilterConfig
from aerial2ground.pure_pursuit import PurePursuitConfig
from aerial2ground.reconstruction import ReconstructionConfig
from aerial2ground.road_network import FARTHEST
from aerial2ground.teleoperation import TeleoperationConfig
from hashnerf.errors import UserError
from hashnerf.training_run import run_folder
from worlds.inertial import InertialConfig


@dataclass(frozen=True)
class EvaluationConfig:
    """What the report of a whole run measures besides the run itself."""

    preset: Literal["fast", "balanced"] = "fast"
    """Which targets are judged."""
    layouts: int = 3
    """Arrangements of the town's houses in which the car is located (Table I)."""
    layout_steps: int = 400
    """Training steps of the fields of the other arrangements."""
    ablation_steps: int = 300
    """Training steps of the fields with parts of the road prior."""

    def __post_init__(self):
        for key in ("layouts", "layout_steps", "ablation_steps"):
            if getattr(self, key) < 1:
                raise UserError(f"evaluation.{key} is {getattr(self, key)}; give at least 1")


@dataclass(frozen=True)
class AerialConfig:
    """From drone pictures to a policy."""

    name: str = "mini_city"
    """Name of the run; parts of a run are named run/part."""
    dataset: str = "data/mini_city"
    """Folder of the drone's pictures."""
    runs: str = "runs"
    """Where runs are written."""
    image_size: int = 0
    """Width to which pictures are reduced; 0 keeps them."""
    road_network: str = ""
    """JSON file of the roads in the frame of the poses, for a data set whose transforms.json has none."""
    scene_box: tuple[float, ...] = ()
    """Region with content (x0, y0, z0, x1, y1, z1), metres, in place of the data set's own."""
    test_every: int = 0
    """Every this many-th picture from the first is held out where no frame names a split; 0: none."""
    seed: int = 0
    """Seed of everything random."""
    seeds: int = 2
    """Networks of every kind, each with a seed of its own in training and in its trials."""
    threads: int = 0
    """Processor threads; 0 uses all cores."""
    overwrite: bool = False
    """Start finished stages anew."""
    reconstruction: ReconstructionConfig = field(default_factory=ReconstructionConfig)
    """The radiance field of the town."""
    camera: CarCameraConfig = field(default_factory=CarCameraConfig)
    """The car's camera."""
    car: CarConfig = field(default_factory=CarConfig)
    """The car's body and actuators."""
    pure_pursuit: PurePursuitConfig = field(default_factory=PurePursuitConfig)
    """The expert driver."""
    imitation: ImitationConfig = field(default_factory=ImitationConfig)
    """Views and training of the steering network."""
    localisation: LocalisationConfig = field(default_factory=LocalisationConfig)
    """Training of the network that tells poses."""
    inertial: InertialConfig = field(default_factory=InertialConfig)
    """The car's inertial sensor."""
    pose_filter: PoseFilterConfig = field(default_factory=PoseFilterConfig)
    """How the network's poses and the sensor's readings are fused."""
    teleoperation: TeleoperationConfig = field(default_factory=TeleoperationConfig)
    """Drives of a person, from which the baselines learn."""
    deployment: DeploymentConfig = field(default_factory=DeploymentConfig)
    """What has changed since the drone flew."""
    drive: DriveConfig = field(default_factory=DriveConfig)
    """How a policy is tried."""
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)
    """What a report measures besides."""
    workers: int = 0
    """Processes that render, train networks and drive; 0 uses all cores."""

    def __post_init__(self):
        for part in self.name.split("/"):
            run_folder(Path(self.runs), part)
        if self.seeds < 1:
            raise UserError(f"seeds is {self.seeds}; give at least 1")
        low, high = self.scene_box[:3], self.scene_box[3:]
        if len(low) != len(high) or len(low) not in (0, 3) or not all(a < b for a, b in zip(low, high)):
            raise UserError(f"scene_box is {list(self.scene_box)}; give x0, y0, z0, x1, y1, z1 with x0 < x1 and so on")
        if not all(abs(value) <= FARTHEST for value in self.scene_box):
            raise UserError(f"scene_box is {list(self.scene_box)}; give metres, up to {FARTHEST:g} from 0")
        if self.test_every < 0 or self.test_every == 1:
            raise UserError(f"test_every is {self.test_every}; give 2 or more, or 0 to hold out no picture")

    @property
    def folder(self) -> Path:
        """The run's folder."""
        return Path(self.runs) / self.name

    @property
    def drives(self) -> Path:
        """The folder of the pictures that a person collected."""
        return self.folder / "drives"


def layout_config(config: AerialConfig, number: int) -> AerialConfig:
    """Returns the config of the run on another arrangement of the town's houses; number 0 is the run itself."""
    if number == 0:
        return config
    return replace(config, name=f"{config.name}_layout_{number}", dataset=f"{config.dataset}_layout_{number}")


def from_drives(config: AerialConfig) -> AerialConfig:
    """Returns the config of a run on the collected pictures: a field without road prior or correction of its poses.

    Its views stray from the path, but no further than such pictures can show.
    """
    reconstruction, imitation = config.reconstruction, config.imitation
    return replace(
        config,
        name=f"{config.name}/from_drives",
        dataset=str(config.drives),
        image_size=0,
        road_network="",
        scene_box=(),
        test_every=0,
        reconstruction=replace(
            reconstruction,
            road_prior=replace(reconstruction.road_prior, share=0.0),
            refine_poses=False,
            steps=config.teleoperation.field_steps,
        ),
        imitation=replace(
            imitation,
            views=config.teleoperation.views,
            disturbance=replace(imitation.disturbance, wrong_side=0.0, near_accident=0.0),
        ),
    )


@dataclass(frozen=True)
class PicturesConfig(AerialConfig):
    """The pipeline's config, and which pictures a radiance field is made of."""

    pictures: Literal["drone", "drives"] = "drone"
    """The drone's, or those that a person collected by driving."""

    @property
    def source(self) -> AerialConfig:
        """The config of the run on those pictures; raises UserError where nobody has collected any."""
        config = AerialConfig(**{item.name: getattr(self, item.name) for item in fields(AerialConfig)})
        if self.pictures == "drone":
            return config
        if not (config.drives / "transforms.json").is_file():
            raise UserError(f"{config.drives}: no collected pictures here; run scripts/collect_drives.py first")
        return from_drives(config)
