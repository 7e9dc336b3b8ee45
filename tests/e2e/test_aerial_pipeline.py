"""aerial2ground through its scripts, small: survey, reconstruction, ground views, policies, drives."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TINY = """
name: tiny
seeds: 1
threads: 1
workers: 1
reconstruction:
  steps: 6
  save_every: 3
  fit: {rays: 128, batch_samples: 4000, occupancy_every: 4}
  field: {levels: 4, log2_table_size: 12, finest_resolution: 64, hidden_width: 16}
  occupancy: {cell: 0.3}
  march: {candidates: 32}
camera: {width: 32, height: 18}
imitation: {views: 4, task: {epochs: 1}}
localisation: {task: {epochs: 1}}
drive: {laps: 1}
"""


def run(script: str, *arguments: str, expect: int = 0) -> str:
    """Runs a script and returns what it printed; its exit status must be the expected one."""
    done = subprocess.run(
        [sys.executable, f"scripts/{script}.py", *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        timeout=300,
    )
    output = done.stdout + done.stderr
    assert done.returncode == expect, output
    assert "Traceback" not in output, output
    return output


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with a small survey and a config for it."""
    folder = tmp_path_factory.mktemp("aerial")
    said = run(
        "make_dataset", "--config", "configs/worlds/mini_city.yaml", "--image_size", "40",
        "--mini_city.survey.images", "16", "--out", str(folder / "city"), "--workers", "1",
    )  # fmt: skip
    assert "16 views of 40 x 30 px" in said
    (folder / "tiny.yaml").write_text(TINY + f"dataset: {folder / 'city'}\nruns: {folder / 'runs'}\n")
    return folder


def test_from_survey_to_drives(place):
    config = ("--config", str(place / "tiny.yaml"))
    run("train_road_nerf", *config)
    assert "already finished" in run("train_road_nerf", *config)
    run("make_ground_views", *config)
    run("train_policy", *config)
    run("train_localizer", *config)
    said = run("export_policy", *config, "--frames", "2").splitlines()
    assert [line.split(":")[0].split("/")[-4:] for line in said] == [
        [name, "ours", "0", "policy.onnx"] for name in ("left_turns", "outer_loop", "right_turns")
    ]
    assert all("differs from torch by at most" in line and "ms a picture" in line for line in said)
    said = run("evaluate_driving", *config)
    rows = [line.split() for line in said.splitlines() if line.startswith(("outer_loop", "left_turns", "right_turns"))]
    assert len(rows) == 6 and all(row[1] in ("expert", "ours") for row in rows)
    assert "ours_imu" in said and (place / "runs" / "tiny" / "driving.json").is_file()


def test_wrong_settings_get_one_sentence(place):
    config = ("--config", str(place / "tiny.yaml"))
    said = run("train_road_nerf", *config, "--name", "new", "--dataset", str(place / "nowhere"), expect=2)
    assert "nowhere" in said
    assert "seeds" in run("evaluate_driving", *config, "--seeds", "0", expect=2)
    assert "frames" in run("export_policy", *config, "--frames", "-1", expect=2)
    assert "run scripts/train_policy" in run("export_policy", *config, "--name", "new", expect=2)
    assert "road_prior" in run("train_road_nerf", *config, "--reconstruction.road_prior.share", "-1", expect=2)
