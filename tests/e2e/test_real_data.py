"""The programs for recordings and surveys of real places, on small made-up ones."""

import json
import sys

import numpy as np
import pytest

from aerial2ground import evaluate_reconstruction
from hashnerf.image_files import write_png
from scripts import evaluate_survey
from tests.e2e.test_aerial_pipeline import TINY, run


@pytest.fixture
def tub(tmp_path):
    """A drive of 40 frames towards a bright bar."""
    folder = tmp_path / "tub"
    (folder / "images").mkdir(parents=True)
    lines = []
    for number in range(40):
        angle = float(np.sin(number / 5))
        picture = np.full((24, 32, 3), 50, np.uint8)
        picture[:, round(15 + 12 * angle) : round(15 + 12 * angle) + 3] = 200
        write_png(folder / "images" / f"{number}.png", picture)
        lines.append({"_index": number, "cam/image_array": f"{number}.png", "user/angle": angle, "user/throttle": 0.4})
    (folder / "catalog_0.catalog").write_text("\n".join(map(json.dumps, lines)))
    (folder / "manifest.json").write_text(json.dumps({"paths": ["catalog_0.catalog"], "deleted_indexes": []}))
    return folder


def test_a_recorded_drive(tub, tmp_path):
    out = tmp_path / "figures.json"
    said = run(
        "evaluate_recording", "--data", str(tub), "--width", "32", "--blocks", "2", "--gap", "3",
        "--task.epochs", "2", "--out", str(out),
    )  # fmt: skip
    assert "40 frames" in said and [row.split()[0] for row in said.splitlines()[-3:]] == [
        "network",
        "linear",
        "constant",
    ]
    figures = json.loads(out.read_text())
    assert figures["frames"] == 40 and len(figures["network"]["r2_blocks"]) == 2
    said = run("evaluate_recording", "--data", str(tub / "images"), expect=2)
    assert "manifest.json: does not exist" in said and len(said.strip().splitlines()) == 1


def test_roads_from_a_map_and_a_survey_without_splits(tmp_path, monkeypatch, capsys):
    run(
        "make_dataset", "--config", "configs/worlds/mini_city.yaml", "--image_size", "40",
        "--mini_city.survey.images", "16", "--out", str(tmp_path / "city"), "--workers", "1",
    )  # fmt: skip
    path = tmp_path / "city" / "transforms.json"
    document = json.loads(path.read_text())
    for key in ("road_network", "trajectories", "world"):
        document.pop(key)
    for frame in document["frames"]:
        frame.pop("split", None)
    path.write_text(json.dumps(document))
    # three metres of road: 1e-5 degrees are 1.11 m to the north
    line = {"type": "LineString", "coordinates": [[0.0, 0.0], [0.0, 1e-5], [0.0, 3e-5]]}
    (tmp_path / "map.geojson").write_text(json.dumps(line))
    roads = str(tmp_path / "roads.json")
    given = ("--geojson", str(tmp_path / "map.geojson"), "--width", "0.7", "--colour", "[90, 90, 90]", "--out", roads)
    assert "1 lines, metres from longitude 0.0" in run("import_roads", *given, "--origin", "[0.0, 1e-5]")
    assert json.loads((tmp_path / "roads.json").read_text())["lines"][0][1] == [0.0, 0.0]
    assert "origin is [1.0]" in run("import_roads", *given, "--origin", "[1.0]", expect=2)

    (tmp_path / "tiny.yaml").write_text(TINY + f"runs: {tmp_path / 'runs'}\n")
    survey = ("--config", str(tmp_path / "tiny.yaml"), "--data", str(tmp_path / "city"), "--road_network", roads)
    assert "holds out no picture" in run("evaluate_survey", *survey, expect=2)
    monkeypatch.setattr(evaluate_reconstruction, "ALIGN_STEPS", 2)  # hence not in a process of its own
    monkeypatch.setattr(sys, "argv", ["evaluate_survey.py", *survey, "--test_every", "8"])
    evaluate_survey.main()
    said = capsys.readouterr().out
    figures = json.loads(said[said.index("{") : said.rindex("}") + 1])
    assert figures["test_pictures"] == 2 and figures["aerial_psnr_db"] > 0
    assert (tmp_path / "runs" / "tiny" / "road_views.png").is_file()
