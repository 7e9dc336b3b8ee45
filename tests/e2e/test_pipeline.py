"""The scripts as a user runs them: data set, trainings (killed, stopped, resumed), forecast, plan, report."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from carff.decisions import decide_from_pictures
from carff.model import load_carff
from hashnerf.image_files import read_rgb

ROOT = Path(__file__).resolve().parents[2]
TINY = """
name: tiny
image_size: 32
threads: 1
device: cpu
pcvae: {steps: 40, batch_size: 16, save_every: 5, encoder: {width: 8}, decoder: {width: 32}}
nerf:
  steps: 12
  birds_eye_steps: 3
  save_every: 5
  fit: {rays: 256, batch_samples: 8192, occupancy_every: 4}
  field: {levels: 4, log2_table_size: 12, finest_resolution: 64, hidden_width: 16}
  occupancy: {cell: 2.0}
  march: {candidates: 48}
mdn: {steps: 40, width: 32, save_every: 20}
probe: {columns: [2, 2], levels: 3}
evaluation: {images: 2, trials: 3, episodes: 2, curve_samples: 4}
"""


def run(*arguments: str, expect: int = 0, cwd: Path = ROOT) -> str:
    """Runs a script and returns what it printed; its exit status must be the expected one."""
    done = subprocess.run(
        [sys.executable, *arguments], cwd=cwd, capture_output=True, text=True, env=environment(), timeout=300
    )
    output = done.stdout + done.stderr
    assert done.returncode == expect, output
    assert "Traceback" not in output, output
    return output


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with a small data set and a config for it."""
    folder = tmp_path_factory.mktemp("pipeline")
    run(
        "scripts/make_dataset.py", "--config", "configs/worlds/intersection.yaml", "--image_size", "32",
        "--out", str(folder / "intersection"), "--workers", "1",
    )  # fmt: skip
    (folder / "tiny.yaml").write_text(TINY + f"dataset: {folder / 'intersection'}\nruns: {folder / 'runs'}\n")
    return folder


def train(place: Path, stage: str, *options: str, expect: int = 0) -> str:
    return run(f"scripts/train_{stage}.py", "--config", str(place / "tiny.yaml"), *options, expect=expect)


def start(place: Path, stage: str, *options: str) -> subprocess.Popen:
    command = [sys.executable, f"scripts/train_{stage}.py", "--config", str(place / "tiny.yaml"), *options]
    return subprocess.Popen(command, cwd=ROOT, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT)


def wait_for_checkpoint(folder: Path, process: subprocess.Popen) -> None:
    while not (folder / "checkpoints" / "last").exists():
        assert process.poll() is None, process.stdout.read().decode()
        time.sleep(0.02)


def model_weights(run_folder: Path, stage: str) -> bytes:
    return (run_folder / stage / "model" / "last" / "tensors.safetensors").read_bytes()


@pytest.fixture(scope="module")
def trained(place: Path) -> Path:
    """A run whose stages were each interrupted once."""
    run_folder = place / "runs" / "tiny"
    process = start(place, "pcvae")
    wait_for_checkpoint(run_folder / "pcvae", process)
    process.kill()
    process.wait()
    assert "continuing after step" in train(place, "pcvae")
    train(place, "nerf")
    train(place, "mdn")
    return run_folder


def test_a_killed_stage_resumes_to_the_weights_of_an_uninterrupted_one(place, trained):
    train(place, "pcvae", "--name", "whole")
    assert model_weights(trained, "pcvae") == model_weights(place / "runs" / "whole", "pcvae")


def test_ctrl_c_saves_and_says_how_to_go_on(place):
    process = start(place, "pcvae", "--name", "stopped", "--pcvae.steps", "100000")
    wait_for_checkpoint(place / "runs" / "stopped" / "pcvae", process)
    process.send_signal(signal.SIGINT)
    output = process.communicate(timeout=60)[0].decode()
    assert process.returncode == 130
    assert "run the same command to continue" in output


def test_a_finished_stage_does_nothing(place, trained):
    assert "already finished" in train(place, "pcvae")


def test_another_config_is_refused_with_the_difference(place, trained):
    before = {name: (trained / name).read_bytes() for name in ("config.yaml", "scene.json")}
    output = train(place, "pcvae", "--pcvae.lr", "0.5", expect=2)
    assert "pcvae.lr: 0.002 -> 0.5" in output
    assert {name: (trained / name).read_bytes() for name in before} == before, "a refused command changes no run"


def test_a_truncated_checkpoint_falls_back_to_the_one_before(place, trained):
    copy = place / "runs" / "torn"
    shutil.copytree(trained, copy, symlinks=True)
    newest = sorted((copy / "pcvae" / "checkpoints").glob("0*"))[-1] / "tensors.safetensors"
    newest.write_bytes(newest.read_bytes()[:1000])
    shutil.rmtree(copy / "pcvae" / "model")
    assert "falling back to step" in train(place, "pcvae", "--name", "torn")


def test_forecast_from_any_picture(place, trained):
    out = place / "forecast"
    image = place / "intersection" / "images"
    picture = next(iter(sorted(image.glob("*.png"))))
    output = run("scripts/forecast.py", "--run", str(trained), "--image", str(picture), "--out", str(out))
    assert "decision:" in output
    document = json.loads((out / "forecast.json").read_text())
    assert abs(sum(document["mixture_weights"]) - 1) < 1e-5
    assert len(list(out.glob("sample*_birds_eye.png"))) == 10
    # the car decides in the same way: one path from a picture to a decision
    model = load_carff(trained)
    pictures, generator = read_rgb(picture)[None], torch.Generator().manual_seed(document["seed"])
    decision = decide_from_pictures(model, torch.as_tensor(pictures), model.config.planner, 10, generator)[0]
    said = {"go": decision.go, "hazard_probability": decision.hazard_probability}
    assert document["decision"] == pytest.approx(said)


def test_a_moved_run_forecasts_without_its_data_set(place, trained, tmp_path):
    shutil.copytree(trained, tmp_path / "moved", symlinks=True)
    picture = sorted((place / "intersection" / "images").glob("*.png"))[0]
    shutil.copy(picture, tmp_path / "unseen.png")
    output = run(
        str(ROOT / "scripts/forecast.py"), "--run", "moved", "--image", "unseen.png", "--samples", "2", cwd=tmp_path
    )
    assert "1 step ahead" in output


def test_report_holds_every_figure(place, trained):
    run("scripts/plan_carla.py", "--config", str(place / "tiny.yaml"))
    run("scripts/evaluate_carff.py", "--config", str(place / "tiny.yaml"))
    report = json.loads((trained / "report.json").read_text())
    assert report["closed_loop"]["risk"]["collisions"] >= 0
    assert 0 <= report["probe"]["accuracy"] <= 1
    assert report["nerf"]["psnr_matched_db"] > 3
    assert (trained / "report.html").stat().st_size > 100_000


def test_a_report_is_about_the_run_as_it_was_trained(place, trained):
    command = ("scripts/evaluate_carff.py", "--config", str(place / "tiny.yaml"))
    output = run(*command, "--nerf.supersample", "3", "--planner.stop_cost", "2", expect=2)
    assert "nerf.supersample: 1 -> 3" in output and "planner.stop_cost: 1.0 -> 2.0" in output


def test_a_decision_needs_a_sampled_future(place, trained):
    output = run("scripts/plan_carla.py", "--run", str(trained), "--samples", "0", expect=2)
    assert "samples is 0; give at least 1" in output


def test_ending_before_training_names_the_script_to_run(place):
    output = run("scripts/train_nerf.py", "--config", str(place / "tiny.yaml"), "--name", "nothing", expect=2)
    assert "train_pcvae.py first" in output
