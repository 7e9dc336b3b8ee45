"""A tiny survey of the mini-city and a run on it, made once."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from aerial2ground.car_camera import CarCameraConfig
from aerial2ground.config import AerialConfig
from aerial2ground.driving import DriveConfig
from aerial2ground.imitation import ImitationConfig
from aerial2ground.localisation import LocalisationConfig
from aerial2ground.policy_training import TaskConfig
from aerial2ground.reconstruction import ReconstructionConfig
from aerial2ground.stages import run_reconstruction
from aerial2ground.teleoperation import TeleoperationConfig
from hashnerf.field import FieldConfig
from hashnerf.fit import FitConfig
from hashnerf.marching import MarchSettings
from hashnerf.occupancy import OccupancyConfig
from worlds.dataset import write_dataset
from worlds.drone_survey import SurveyConfig
from worlds.mini_city import MiniCityConfig

TINY = ReconstructionConfig(
    field=FieldConfig(
        levels=4, log2_table_size=12, base_resolution=8, finest_resolution=64, hidden_width=16, ground=True
    ),
    occupancy=OccupancyConfig(cell=0.3),
    march=MarchSettings(candidates=48, even_distance=1.0, near=0.02),
    fit=FitConfig(rays=256, batch_samples=6000, occupancy_every=4),
    steps=30,
    save_every=15,
)


@pytest.fixture(scope="session")
def survey_folder(tmp_path_factory) -> Path:
    """A data set of 24 small pictures."""
    folder = tmp_path_factory.mktemp("survey")
    write_dataset(MiniCityConfig(survey=SurveyConfig(images=24)), 0, folder, 40, 1)
    return folder


@pytest.fixture(scope="session")
def _trained(tmp_path_factory, survey_folder) -> AerialConfig:
    config = AerialConfig(
        name="tiny",
        dataset=str(survey_folder),
        runs=str(tmp_path_factory.mktemp("runs")),
        threads=1,
        seeds=1,
        reconstruction=TINY,
        camera=CarCameraConfig(width=32, height=18),
        imitation=ImitationConfig(views=6, task=TaskConfig(epochs=1)),
        localisation=LocalisationConfig(task=TaskConfig(epochs=1)),
        teleoperation=TeleoperationConfig(laps=1, field_steps=20, views=4),
        drive=DriveConfig(laps=1),
        workers=1,
    )
    run_reconstruction(config)
    return config


@pytest.fixture
def tiny_run(_trained, tmp_path) -> AerialConfig:
    """A config whose reconstruction is trained, in a folder of the test's own."""
    config = replace(_trained, runs=str(tmp_path / "runs"))
    shutil.copytree(_trained.folder, config.folder)
    return config
