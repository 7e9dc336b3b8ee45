"""Every fault is done once to a driving car; docs/results/bridge.md has twenty times each, measured alone."""

import pytest

from aerial2ground.bridge.rig import Rig
from aerial2ground.bridge.trials import TRIALS, repeat
from aerial2ground.bridge.wire import has_alive, strangers

ROWS = {
    "kill": "R14",
    "stop": "R06",
    "exception": "X1",
    "nan": "R07",
    "still": "X4",
    "repeat": "R05",
    "unplug": "R05",
    "e_stop": "R24",
    "dead_man": "R03",
    "telemetry": "R19",
}


@pytest.mark.parametrize("trial", TRIALS, ids=lambda trial: trial.name)
def test_r03_r05_r06_r07_r14_r19_r24_x1_x4_a_driving_car_brakes_in_time(trial, tmp_path, bridge_row):
    rigs = []

    def make_rig(trial, number):
        rigs.append(Rig(tmp_path / str(number), policy=trial.policy))
        return rigs[-1]

    (took,) = repeat(trial, make_rig, 1)
    received = rigs[0].vesc.received
    assert not has_alive(received) and not strangers(received)
    assert rigs[0].vesc.dropped == 0
    bridge_row(ROWS[trial.name], f"{trial.what}: first brake frame after", 1000 * took, 1000 * trial.allowed, "ms", 2)
