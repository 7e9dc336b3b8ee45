import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from hashnerf.command_line import parse_config
from hashnerf.errors import UserError
from hashnerf.posed_images import load_posed_images
from hashnerf.transforms_json import write_transforms
from worlds.cube_cylinder import CubeCylinderConfig
from worlds.dataset import world_description
from worlds.dataset_folder import DatasetConfig, make_dataset
from worlds.scenarios import build_world

ROOT = Path(__file__).parents[2]


def small(folder: Path, **changes) -> DatasetConfig:
    return replace(DatasetConfig(scenario="cube_cylinder", image_size=8, workers=1, out=folder), **changes)


def script(*arguments):
    command = [sys.executable, "scripts/make_dataset.py", *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=120)


def test_script_end_to_end(tmp_path):
    out = tmp_path / "data"
    preset = ("--config", "configs/worlds/intersection.yaml", "--out", out, "--image_size", 16, "--workers", 1)
    first = script(*preset, "--glb", tmp_path / "scene.glb")
    assert first.returncode == 0, first.stderr
    for piece in ("600 views", "56 ego, 43 elevated, 1 birds_eye", "528 train, 72 test", "present 2 (hazard)", "truck"):
        assert piece in first.stdout
    assert len(load_posed_images(out)) == 600
    assert (tmp_path / "scene.glb").stat().st_size > 100_000
    other = script(*preset, "--seed", 1)
    assert other.returncode == 2
    assert (
        other.stderr.strip() == f"{out}: holds another data set; give --overwrite true to replace it, or another --out."
    )


def test_a_wrong_key_is_named():
    with pytest.raises(UserError, match=r"did you mean 'intersection\.truck_start'\?"):
        parse_config(DatasetConfig, ["--intersection.truck_stat", "3"])


@pytest.mark.parametrize("name", ["intersection", "two_lane_merge", "single_scene_intersection", "cube_cylinder"])
def test_presets_name_their_own_scenario(name):
    config = parse_config(DatasetConfig, ["--config", str(ROOT / f"configs/worlds/{name}.yaml")])
    assert config.scenario == name and config.folder == Path("data") / name


@pytest.fixture
def quick(monkeypatch):
    """Stands in for the renderer: two cameras, one file, and the document that says which world it is."""

    def write(config, seed, folder, image_size, workers, on_camera):
        (folder / "picture").write_text(str(seed))
        for done in (1, 2):
            on_camera(done, 2)
        document = {"world": world_description(build_world(config, seed)), "w": image_size}
        write_transforms(folder / "transforms.json", document)
        return document

    monkeypatch.setattr("worlds.dataset_folder.write_dataset", write)


@pytest.mark.usefixtures("quick")
def test_overwrite_replaces_and_leaves_nothing_beside(tmp_path):
    make_dataset(small(tmp_path / "data"))
    assert make_dataset(small(tmp_path / "data", seed=1, overwrite=True)).rendered
    assert (tmp_path / "data" / "picture").read_text() == "1"
    assert [path.name for path in tmp_path.iterdir()] == ["data"]
    assert not make_dataset(small(tmp_path / "data", seed=1)).rendered


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("change", [{"image_size": 9}, {"seed": 2}, {"cube_cylinder": CubeCylinderConfig(move=3.0)}])
def test_another_size_seed_or_setting_is_another_data_set(tmp_path, change):
    make_dataset(small(tmp_path / "data"))
    with pytest.raises(UserError, match="holds another data set"):
        make_dataset(small(tmp_path / "data", **change))


def test_a_folder_with_other_files_is_never_touched(tmp_path):
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(UserError, match="is not empty and not a data set"):
        make_dataset(small(tmp_path, overwrite=True))
    assert (tmp_path / "thesis.txt").read_text() == "years of work"


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("before", [False, True])
def test_an_interrupted_run_leaves_what_was_there(tmp_path, before):
    out = tmp_path / "data"
    if before:
        make_dataset(small(out))

    def interrupt(done, total):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_dataset(small(out, seed=1, overwrite=True), interrupt)
    assert [path.name for path in tmp_path.iterdir()] == (["data"] if before else [])
    assert not before or (out / "picture").read_text() == "0"


def test_ctrl_c_with_workers_ends_with_one_line_and_no_data(tmp_path):
    out = tmp_path / "data"
    command = [sys.executable, "scripts/make_dataset.py", "--out", str(out), "--workers", "2"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(
        command,
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # A test run started in the background ignores Ctrl-C and hands that down; a terminal does not.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    deadline = time.monotonic() + 90
    while not list(tmp_path.glob(".data.*/images/*.png")) and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to every process of the group
    _, complaint = process.communicate(timeout=90)
    assert process.returncode == 130
    assert complaint.strip() == "Interrupted."
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="file"):
        make_dataset(small(tmp_path / "file" / "data"))


def test_settings_of_another_scenario_are_refused():
    with pytest.raises(UserError, match="cube_cylinder: settings are given, but scenario = intersection"):
        DatasetConfig(cube_cylinder=CubeCylinderConfig(move=3.0))


@pytest.mark.parametrize(("key", "value"), [("seed", -1), ("image_size", 4), ("workers", 0)])
def test_numbers_out_of_range_are_refused(key, value):
    with pytest.raises(UserError, match=f"{key} = {value} is out of range"):
        DatasetConfig(**{key: value})
