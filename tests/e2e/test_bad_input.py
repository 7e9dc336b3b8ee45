"""Wrong files and settings through the scripts: one clear sentence, status 2, nothing lost."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]


def refused(folder: Path, *options: str) -> str:
    """Runs stage 1 on a data set and returns what it says; it must refuse politely."""
    command = [sys.executable, "scripts/train_pcvae.py", "--dataset", str(folder), "--runs", str(folder / "runs")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run([*command, *options], cwd=ROOT, capture_output=True, text=True, env=environment, timeout=120)
    assert done.returncode == 2, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    assert not (folder / "runs").exists()
    return done.stderr


@pytest.fixture
def data(tmp_path) -> Path:
    """Two states seen by two cameras, written by hand as a user would."""
    (tmp_path / "images").mkdir()
    frames = []
    for step in range(2):
        for camera in range(2):
            name = f"images/s{step}_c{camera}.png"
            Image.fromarray(np.full((32, 32, 3), 40 * step + 10 * camera, np.uint8)).save(tmp_path / name)
            pose = np.eye(4)
            pose[0, 3] = camera
            frames.append(
                {"file_path": name, "transform_matrix": pose.tolist(), "branch": 0, "step": step, "camera": camera}
            )
    write(tmp_path, {"w": 32, "h": 32, "fl_x": 30, "fl_y": 30, "frames": frames})
    return tmp_path


def read(folder: Path) -> dict:
    return json.loads((folder / "transforms.json").read_text())


def write(folder: Path, document: dict) -> None:
    (folder / "transforms.json").write_text(json.dumps(document))


def test_k40_all_problems_are_listed_at_once(data, numeric_row):
    document = read(data)
    (data / "images/s0_c0.png").unlink()
    broken = data / "images/s0_c1.png"
    broken.write_bytes(broken.read_bytes()[:40])
    document["frames"][2]["file_path"] = "../outside.png"
    document["frames"][3]["transform_matrix"][0][0] = 1.5
    write(data, document)
    output = refused(data)
    untold = [words for words in ("s0_c0.png", "s0_c1.png", "outside.png", "frame 3") if words not in output]
    numeric_row("K40", "a training on four bad frames (exit 2): not told", len(untold))


def test_a_pose_that_is_not_a_number(data):
    text = (data / "transforms.json").read_text().replace("[0.0, 1.0, 0.0, 0.0]", "[0.0, NaN, 0.0, 0.0]", 1)
    (data / "transforms.json").write_text(text)
    assert "NaN" in refused(data)


def test_k44_a_state_without_views(data, numeric_row):
    document = read(data)
    document["states"] = [{"branch": 0, "step": step, "hazard": False} for step in range(3)]
    write(data, document)
    numeric_row(
        "K44", "a training on a state without views (exit 2): not named", "branch 0 step 2" not in refused(data)
    )


def test_an_unknown_key_names_the_nearest(data):
    assert "pcvae.steps" in refused(data, "--pcvae.stebs", "10")


def test_a_value_of_the_wrong_type_names_key_and_value(data):
    output = refused(data, "--pcvae.steps", "many")
    assert "pcvae.steps" in output and "many" in output


def test_k43_a_data_set_without_training_views(data, numeric_row):
    document = read(data)
    for frame in document["frames"]:
        frame["split"] = "test"
    write(data, document)
    told = "no view has the split `train`" in refused(data)
    numeric_row("K43", "a training on test views alone (exit 2): not told", not told)


def test_a_missing_folder(tmp_path):
    assert "transforms.json" in refused(tmp_path / "nothing")


def test_a_data_set_is_checked_without_training(data):
    def check() -> subprocess.CompletedProcess:
        command = [sys.executable, "scripts/check_dataset.py", "--dataset", str(data)]
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
        return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=environment, timeout=120)

    good = check()
    assert good.returncode == 0, good.stderr
    assert good.stdout.splitlines()[:2] == [
        "4 views of 2 states in 1 branches, 32 x 32 pixels",
        "cameras: 2 train, 0 val, 0 test",
    ]
    document = read(data)
    write(data, {**document, "frames": [{**frame, "split": "test"} for frame in document["frames"]]})
    untrainable = check()
    assert untrainable.returncode == 2 and "nothing can be trained" in untrainable.stderr
    for frame in document["frames"][:2]:
        frame["brnch"] = frame.pop("branch")
    write(data, document)
    bad = check()
    assert bad.returncode == 2 and "did you mean 'branch'? (the same in 1 other frames)" in bad.stderr
