import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from hashnerf.errors import UserError
from hashnerf.posed_images import load_posed_images
from worlds.cube_cylinder import CubeCylinderConfig
from worlds.dataset_folder import DatasetConfig, make_dataset

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
    again = script(*preset)
    assert again.returncode == 0 and "is there already" in again.stdout
    other = script(*preset, "--seed", 1)
    assert other.returncode == 2
    assert (
        other.stderr.strip() == f"{out}: holds another data set; give --overwrite true to replace it, or another --out."
    )


def test_script_names_a_wrong_key():
    result = script("--intersection.truck_stat", 3)
    assert result.returncode == 2 and "did you mean 'intersection.truck_start'?" in result.stderr


@pytest.mark.parametrize("name", ["intersection", "two_lane_merge", "single_scene_intersection", "cube_cylinder"])
def test_presets_name_their_own_scenario(name):
    from hashnerf.command_line import parse_config

    config = parse_config(DatasetConfig, ["--config", str(ROOT / f"configs/worlds/{name}.yaml")])
    assert config.scenario == name and config.folder == Path("data") / name


def test_overwrite_replaces_and_leaves_nothing_beside(tmp_path):
    make_dataset(small(tmp_path / "data"))
    made = make_dataset(small(tmp_path / "data", seed=1, overwrite=True))
    assert made.rendered and made.document["world"]["seed"] == 1
    assert [path.name for path in tmp_path.iterdir()] == ["data"]
    assert not make_dataset(small(tmp_path / "data", seed=1)).rendered


def test_another_image_size_is_another_data_set(tmp_path):
    make_dataset(small(tmp_path / "data"))
    with pytest.raises(UserError, match="holds another data set"):
        make_dataset(small(tmp_path / "data", image_size=9))


def test_a_folder_with_other_files_is_never_touched(tmp_path):
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(UserError, match="is not empty and not a data set"):
        make_dataset(small(tmp_path, overwrite=True))
    assert (tmp_path / "thesis.txt").read_text() == "years of work"


@pytest.mark.parametrize("before", [False, True])
def test_an_interrupted_run_leaves_what_was_there(tmp_path, before):
    out = tmp_path / "data"
    if before:
        make_dataset(small(out))

    def interrupt(done, total):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_dataset(small(out, seed=1, overwrite=True), interrupt)
    assert [path.name for path in tmp_path.iterdir()] == (["data"] if before else [])
    assert not before or not make_dataset(small(out)).rendered


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
