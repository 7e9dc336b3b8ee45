"""The config of the aerial2ground pipeline: one file for all stages."""

from dataclasses import dataclass, field
from pathlib import Path

from aerial2ground.car import CarConfig
from aerial2ground.car_camera import CarCameraConfig
from aerial2ground.deployment import DeploymentConfig
from aerial2ground.driving import DriveConfig
from aerial2ground.imitation import ImitationConfig
from aerial2ground.pure_pursuit import PurePursuitConfig
from aerial2ground.reconstruction import ReconstructionConfig


@dataclass(frozen=True)
class AerialConfig:
    """From drone pictures to a policy."""

    name: str = "mini_city"
    """Name of the run."""
    dataset: str = "data/mini_city"
    """Folder of the drone's pictures."""
    runs: str = "runs"
    """Where runs are written."""
    image_size: int = 0
    """Width to which pictures are reduced; 0 keeps them."""
    seed: int = 0
    """Seed of everything random."""
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
    deployment: DeploymentConfig = field(default_factory=DeploymentConfig)
    """What has changed since the drone flew."""
    drive: DriveConfig = field(default_factory=DriveConfig)
    """How a policy is tried."""
    workers: int = 0
    """Processes that render; 0 uses all cores."""

    @property
    def folder(self) -> Path:
        """The run's folder."""
        return Path(self.runs) / self.name
