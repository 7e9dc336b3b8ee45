"""Tables of drives."""

import json

import numpy as np
import pytest

from aerial2ground.driving import Drive
from aerial2ground.evaluate_driving import Trial, drive_trials, save_drives, table_two
from aerial2ground.stages import load_survey


def driven(lateral: float, degrees: float, interventions: int) -> Drive:
    places = np.zeros((interventions, 2))
    return Drive(
        np.full(5, lateral),
        np.radians(np.full(5, degrees)),
        np.zeros((5, 2)),
        np.zeros((21, 4)),
        places,
        np.arange(len(places)),
    )


def trial(method: str, seed: int, path=None) -> Trial:
    return Trial("loop", method, seed, path, None)


def test_means_and_spreads_over_seeds(tiny_run):
    path = load_survey(tiny_run).trajectories["outer_loop"]
    trials = [trial("ours", 0, path), trial("ours", 1, path), trial("expert", 0, path)]
    drives = [driven(0.02, 2.0, 0), driven(0.04, 4.0, 3), driven(0.01, 1.0, 0)]
    row = table_two(trials, drives)["loop"]["ours"]
    assert row["pos_m"] == pytest.approx(0.03) and row["pos_m_spread"] == pytest.approx(0.01)
    assert row["yaw_deg"] == pytest.approx(3.0) and row["yaw_deg_spread"] == pytest.approx(1.0)
    assert (row["interventions"], row["most_interventions"], row["runs"]) == (1.5, 3, 2)
    save_drives(tiny_run, trials, drives)
    saved = json.loads((tiny_run.folder / "driving.json").read_text())
    assert [track["seed"] for track in saved["tracks"]] == [0, 1, 0]


def test_processes_change_nothing(tiny_run):
    survey = load_survey(tiny_run)
    world, path = survey.data.extras["world"], survey.trajectories["right_turns"]
    trials = [trial("expert", seed, path) for seed in (0, 1)]
    alone, together = (drive_trials(tiny_run, world, (0.0, 0.0), trials, workers) for workers in (1, 2))
    for one, other in zip(alone, together):
        assert np.array_equal(one.track, other.track) and one.interventions == 0
    assert not np.array_equal(alone[0].track[0], alone[1].track[0])
