"""A static scene as a user meets it: pictures in, a field and its figures out, within seconds that the user names."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def run(*arguments: str, expect: int = 0) -> str:
    """Runs a script and returns what it printed; its exit status must be the expected one."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, env=environment, timeout=300
    )
    output = done.stdout + done.stderr
    assert done.returncode == expect, output
    assert "Traceback" not in output, output
    return output


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with small pictures of a box in the air, and of nothing."""
    folder = tmp_path_factory.mktemp("static")
    for boxes, name in ((1, "box"), (0, "empty")):
        run(
            "scripts/make_dataset.py", "--scenario", "one_box", "--one_box.boxes", str(boxes), "--image_size", "24",
            "--workers", "1", "--out", str(folder / name),
        )  # fmt: skip
    return folder


def train(place: Path, name: str, *arguments: str, expect: int = 0) -> str:
    own = ("--dataset", str(place / name), "--runs", str(place / "runs"), "--name", name, "--threads", "1")
    return run("scripts/train_static_nerf.py", *own, *arguments, expect=expect)


def test_pictures_in_figures_out_and_the_same_again_trains_no_more(place):
    output = train(place, "box", "--steps", "30", "--fit.batch_samples", "2048")
    assert "capacity: pixels cover" in output
    folder = place / "runs" / "box"
    results = json.loads((folder / "reconstruction.json").read_text())
    assert results["test_pictures"] == 8 and results["psnr_db"] > 10
    assert {"config.yaml", "held_out.png", "field"} <= {path.name for path in folder.iterdir()}
    assert "already finished" in train(place, "box", "--steps", "30", "--fit.batch_samples", "2048")


def test_an_empty_sky_is_taken_for_empty_and_has_no_samples(place):
    assert "taken for empty" in train(place, "empty", "--steps", "61")
    lines = (place / "runs" / "empty" / "field" / "metrics.jsonl").read_text().splitlines()
    assert json.loads(lines[-1])["samples"] == 0
    assert json.loads((place / "runs" / "empty" / "reconstruction.json").read_text())["psnr_db"] > 20


def test_seconds_that_no_preset_fits_into_are_refused_with_what_would(place):
    output = train(place, "box", "--max_seconds", "0.01", "--overwrite", "true", expect=2)
    assert "max_seconds is 0.01: no preset fits 1.3 times over (fast" in output and "give at least" in output


def test_a_run_that_was_begun_keeps_its_steps(place):
    train(place, "box", "--steps", "2", "--name", "short")
    output = train(place, "box", "--name", "short", "--max_seconds", "100")
    assert "was begun with 2 steps and keeps them" in output


def test_a_state_that_is_not_there_is_named(place):
    assert "no training picture of branch 3, step 0" in train(place, "box", "--branch", "3", expect=2)
