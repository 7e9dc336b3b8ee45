"""A survey as of a real place: no splits, no trajectories, roads with heights in a file of their own."""

import json
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch

from aerial2ground import evaluate_reconstruction
from aerial2ground.car_camera import CarCameraConfig
from aerial2ground.evaluate_survey import evaluate_survey, road_cameras, sheet
from aerial2ground.road_network import RoadNetwork
from hashnerf.errors import UserError
from hashnerf.image_files import read_rgb


@pytest.fixture
def photographs(tiny_run, tmp_path, monkeypatch):
    """A config for photographs and roads that nobody but a camera and a pencil has described."""
    monkeypatch.setattr(evaluate_reconstruction, "ALIGN_STEPS", 2)
    folder = tmp_path / "photographs"
    shutil.copytree(tiny_run.dataset, folder, ignore=shutil.ignore_patterns("truth.json"))
    document = json.loads((folder / "transforms.json").read_text())
    roads = document.pop("road_network")
    roads.pop("height", None)
    roads["lines"] = [[[x, y, 0.0] for x, y in line] for line in roads["lines"]]
    (tmp_path / "roads.json").write_text(json.dumps(roads))
    for key in ("trajectories", "world"):
        document.pop(key)
    for frame in document["frames"]:
        frame.pop("split", None)
    (folder / "transforms.json").write_text(json.dumps(document))
    return replace(
        tiny_run,
        name="photographs",
        dataset=str(folder),
        road_network=str(tmp_path / "roads.json"),
        test_every=8,
        reconstruction=replace(tiny_run.reconstruction, steps=8, save_every=4),
    )


def test_figures_and_pictures(photographs):
    results = evaluate_survey(photographs)
    assert results["test_pictures"] == 3 and "ground" not in results and "poses" not in results
    assert all(math.isfinite(value) for key, value in results.items() if key != "weights")
    assert results == json.loads((photographs.folder / "reconstruction.json").read_text())
    assert read_rgb(photographs.folder / "held_out.png").shape == (3 * 30, 2 * 40, 3)
    assert read_rgb(photographs.folder / "road_views.png").shape == (3 * 18, 3 * 32, 3)
    again = evaluate_survey(photographs) | {"seconds": results["seconds"]}
    assert again == results, "a finished run is only measured"


def test_nothing_held_out(photographs):
    with pytest.raises(UserError, match="holds out no picture; name splits"):
        evaluate_survey(replace(photographs, test_every=0))


def test_a_car_on_a_road_that_rises():
    line, heights = torch.tensor([[0.0, 0.0], [0.0, 40.0]]), torch.tensor([1.0, 5.0])
    roads = RoadNetwork((line,), 4.0, 3.0, torch.zeros(1, 3), (heights,))
    cameras = road_cameras(roads, CarCameraConfig(above_road=1.5, ahead=0.0, pitch=0.0), 4)
    # places after 1/8, 3/8, 5/8 and 7/8 of 40 m; 1 m up for every 10 m; the camera 1.5 m above that, looking along +y
    expected = torch.tensor([[0.0, 5.0, 3.0], [0.0, 15.0, 4.0], [0.0, 25.0, 5.0], [0.0, 35.0, 6.0]])
    assert torch.allclose(cameras.pose[:, :3, 3], expected, atol=1e-5)
    assert torch.allclose(-cameras.pose[:, :3, 2], torch.tensor([0.0, 1.0, 0.0]).expand(4, 3), atol=1e-6)


def test_a_sheet_by_hand():
    tiles = [np.full((2, 3, 3), value, np.uint8) for value in (1, 2, 3)]
    whole = sheet(tiles, 2)
    assert whole.shape == (4, 6, 3)
    assert whole[0, 0, 0] == 1 and whole[0, 3, 0] == 2 and whole[2, 0, 0] == 3 and whole[3, 5, 2] == 255
