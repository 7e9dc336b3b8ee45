"""A survey of a real place: held-out photographs beside their renderings, and what a car would see along its road.

No truth is known there but the photographs: figures come from those held out; views from the ground are to be looked
at.
"""

import numpy as np
import torch
from jaxtyping import UInt8

from aerial2ground.car_camera import CarCameraConfig, car_cameras
from aerial2ground.config import AerialConfig
from aerial2ground.evaluate_reconstruction import evaluate_run
from aerial2ground.paths import Path
from aerial2ground.reconstruction import RoadNerf
from aerial2ground.road_network import RoadNetwork
from aerial2ground.stages import load_nerf, load_survey, run_reconstruction
from hashnerf.cameras import Cameras
from hashnerf.errors import UserError
from hashnerf.image_files import write_png
from hashnerf.posed_images import PosedImages

SHOWN = 3
"""Held-out photographs in the picture."""
ROAD_VIEWS, ROAD_COLUMNS = 9, 3
"""Views along the first line of the road network."""
CHORD = 4.0
"""Metres over which the road's heading is taken: a drawn line has corners."""


def evaluate_survey(config: AerialConfig) -> dict:
    """Trains on a survey (or continues) and measures it; returns the figures.

    Writes reconstruction.json, held_out.png (photograph left, rendering right) and road_views.png to the run's folder.
    Raises UserError for a survey that holds out no picture.
    """
    survey = load_survey(config)
    if not len(survey.test):
        raise UserError(f"{config.dataset}: holds out no picture; name splits in transforms.json, or give test_every")
    run_reconstruction(config)
    results = evaluate_run(config)
    nerf, _ = load_nerf(config, survey)
    write_png(config.folder / "held_out.png", comparisons(nerf, survey.test, SHOWN))
    cameras = road_cameras(survey.network, config.camera, ROAD_VIEWS)
    views = [picture(nerf, cameras, index) for index in range(ROAD_VIEWS)]
    write_png(config.folder / "road_views.png", sheet(views, ROAD_COLUMNS))
    return results


def comparisons(nerf: RoadNerf, data: PosedImages, count: int) -> UInt8[np.ndarray, "h w 3"]:
    """Returns photographs, evenly chosen, with the rendering from the told pose beside each."""
    rows = np.unique(np.linspace(0, len(data) - 1, min(count, len(data))).round().astype(int))
    pairs = [shown for row in rows for shown in (data.images[row].numpy(), picture(nerf, data.cameras, int(row)))]
    return sheet(pairs, 2)


def road_cameras(network: RoadNetwork, camera: CarCameraConfig, count: int) -> Cameras:
    """Returns the camera of a car at evenly spaced places of the network's first line, looking along it."""
    path = Path(network.lines[0].double().numpy())
    poses = torch.from_numpy(path.poses((np.arange(count) + 0.5) / count * path.length, CHORD))
    return car_cameras(camera, poses, network.heights_at(poses[:, :2]))


def picture(nerf: RoadNerf, cameras: Cameras, index: int) -> UInt8[np.ndarray, "h w 3"]:
    """Returns what a camera sees of the field."""
    seen = nerf.view(cameras, index).rgb.clamp(0, 1)
    return (seen * 255).round().to(torch.uint8).view(cameras.height, cameras.width, 3).numpy()


def sheet(pictures: list[UInt8[np.ndarray, "h w 3"]], columns: int) -> UInt8[np.ndarray, "h2 w2 3"]:
    """Returns pictures of one size in rows of `columns`; empty places are white."""
    empty = np.full_like(pictures[0], 255)
    padded = [*pictures, *[empty] * (-len(pictures) % columns)]
    rows = [np.concatenate(padded[start : start + columns], axis=1) for start in range(0, len(padded), columns)]
    return np.concatenate(rows)
