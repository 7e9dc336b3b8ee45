"""aerial2ground through its scripts, small: survey, reconstruction, ground views, policies, drives."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from aerial2ground.evaluate_reconstruction import true_poses
from aerial2ground.pose_refinement import pose_errors
from hashnerf.posed_images import load_posed_images

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


def test_a_survey_with_wrong_poses_is_aligned(tmp_path):
    run(
        "make_dataset", "--config", "configs/worlds/mini_city.yaml", "--image_size", "160",
        "--mini_city.survey.images", "48", "--mini_city.survey.position_noise", "0.02",
        "--mini_city.survey.angle_noise", "1.5", "--mini_city.survey.oblique_share", "0.5",
        "--mini_city.survey.flattest", "35", "--mini_city.survey.steepest", "60",
        "--out", str(tmp_path / "city"), "--workers", "1",
    )  # fmt: skip
    options = ("--alignment.position_std", "0.02", "--alignment.angle_std", "1.5", "--threads", "1")
    said = run("align_survey", "--dataset", str(tmp_path / "city"), "--out", str(tmp_path / "aligned"), *options)
    assert "round 5: " in said and "(median)" in said

    kept = json.loads((tmp_path / "aligned" / "alignment.json").read_text())["kept_as_told"]
    assert len(kept) <= 4

    def errors(folder: Path) -> tuple[float, float]:
        data = load_posed_images(folder).split("train")
        rows = torch.tensor([frame.file_path not in kept for frame in data.frames])
        metres, radians = pose_errors(data.cameras.pose[rows], true_poses(folder, data)[rows])
        return float(metres.square().mean().sqrt()), float(radians.square().mean().sqrt())

    before, after = errors(tmp_path / "city"), errors(tmp_path / "aligned")
    assert after[0] < 0.5 * before[0] and after[1] < 0.3 * before[1]
    again = run("align_survey", "--dataset", str(tmp_path / "city"), "--out", str(tmp_path / "aligned"), expect=2)
    assert "is there already" in again
    said = run("align_survey", "--dataset", str(tmp_path / "none"), "--out", str(tmp_path / "x"), expect=2)
    assert "none" in said and "transforms.json" in said and not (tmp_path / "x").exists()
