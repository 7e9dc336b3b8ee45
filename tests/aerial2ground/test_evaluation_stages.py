"""Tables I and II of a run, its other channel, and photographs in which nobody can drive."""

import json
import math
import shutil
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from aerial2ground.deployment import Deployment
from aerial2ground.evaluation_stages import run_driving, run_localisation, table_row
from aerial2ground.evaluation_stages import test_drives as laps_to_locate
from aerial2ground.exported_policy import load_exported
from aerial2ground.learning_stages import policy_folder, run_drives, run_localisers, run_policies
from aerial2ground.networks import NetworkConfig
from aerial2ground.policy_export import export_trained
from aerial2ground.stages import run_ground_views
from hashnerf.errors import UserError

NAMES = {"outer_loop", "left_turns", "right_turns"}


def test_table_two_with_the_expert_and_the_time_of_a_picture(tiny_run):
    run_ground_views(tiny_run)
    run_policies(tiny_run)
    table = run_driving(tiny_run)
    assert set(table) == NAMES and set(table["outer_loop"]) == {"expert", "ours"}
    expert = table["outer_loop"]["expert"]
    assert expert["interventions"] == 0 and expert["pos_m"] < 0.05
    saved = json.loads((tiny_run.folder / "driving.json").read_text())
    assert saved["table2"] == table and len(saved["tracks"]) == 6 and set(saved["paths"]) == NAMES
    track = saved["tracks"][0]
    assert len(track["track"]) == len(track["lateral"]) == len(track["heading"])
    assert 0 < json.loads((tiny_run.folder / "latency.json").read_text())["latency_ms_1thread"] < 1000


def test_table_one_of_baseline_ours_and_fused(tiny_run):
    run_ground_views(tiny_run)
    run_drives(tiny_run)
    run_localisers(tiny_run)
    table = run_localisation(tiny_run)
    assert set(table) == {"baseline", "ours", "ours_imu"}
    assert all(0 < row["pos_m"] < 20 and 0 < row["yaw_deg"] <= 180 for row in table.values())
    saved = json.loads((tiny_run.folder / "localisation.json").read_text())
    assert saved["table1"] == table and {track["trajectory"] for track in saved["tracks"]} == NAMES
    assert sum(len(track["truth"]) for track in saved["tracks"]) == saved["test_pictures"]
    again = run_localisation(tiny_run)
    assert again == table, "the same drives every time"


def test_a_lap_to_be_located_ends_where_the_car_is_lifted(tiny_run, monkeypatch):
    whole = laps_to_locate(replace(tiny_run, workers=1))[0]
    calls = count()
    monkeypatch.setattr(Deployment, "touches", lambda self, corners: next(calls) == 20)
    broken = laps_to_locate(replace(tiny_run, workers=1))[0]
    assert len(broken.pictures) == len(broken.poses) == len(broken.times) == 21 < len(whole.poses)
    assert broken.readings.time[-1] == pytest.approx(2.1)
    # a person's car neither jumps nor turns on the spot, though it strays further than a policy may
    for drive in (whole, broken):
        assert np.abs(drive.readings.yaw_rate).max() < 3
        assert np.linalg.norm(np.diff(drive.poses[:, :2], axis=0), axis=1).max() < 0.09


def test_rows_are_means_over_seeds_of_all_pictures_together():
    truth = [np.zeros((2, 3)), np.zeros((2, 3))]
    far = [np.array([(3.0, 4.0, 0.0)] * 2), np.zeros((2, 3))]
    row = table_row([truth, far], truth)
    # the second seed: 5 m in half of the pictures
    assert row["pos_m"] == pytest.approx((0 + 5 / math.sqrt(2)) / 2)
    assert row["pos_m_spread"] == pytest.approx(5 / math.sqrt(2) / 2) and row["runs"] == 2
    assert row["pos_m_median"] == pytest.approx((0 + 2.5) / 2)


def test_depth_goes_through_every_stage_by_one_switch(tiny_run):
    task = replace(tiny_run.imitation.task, network=NetworkConfig(depth=True))
    config = replace(tiny_run, imitation=replace(tiny_run.imitation, task=task))
    run_ground_views(tiny_run)
    run_policies(config)
    table = run_driving(config)
    assert all(math.isfinite(row["pos_m"]) for rows in table.values() for row in rows.values())
    # what was learned with depth neither drives nor is exported without it
    with pytest.raises(UserError, match="does not fit"):
        run_driving(tiny_run)
    export = export_trained(policy_folder(config, "outer_loop", "ours", 0), config)
    assert load_exported(export.path).info.shape == (18, 32, 4)


def test_photographs_cannot_be_driven_in(tiny_run, tmp_path):
    folder = tmp_path / "photographs"
    shutil.copytree(tiny_run.dataset, folder)
    path = Path(folder) / "transforms.json"
    document = json.loads(path.read_text())
    del document["world"]
    path.write_text(json.dumps(document))
    config = replace(tiny_run, dataset=str(folder))
    run_ground_views(config)
    run_policies(config)
    run_localisers(config)
    for stage in (run_driving, run_localisation, run_drives):
        with pytest.raises(UserError, match="not rendered from an embedded world"):
            stage(config)
