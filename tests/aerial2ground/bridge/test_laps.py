from dataclasses import fields

import pytest

from aerial2ground.bridge.fake_car import FakeCarConfig
from aerial2ground.bridge.laps import drive_both, policy_file
from aerial2ground.bridge.rig import HEIGHT, ROOT, WIDTH
from aerial2ground.bridge.trial_policies import trial_policy
from aerial2ground.car_camera import CarCameraConfig
from aerial2ground.config import AerialConfig
from hashnerf.errors import UserError


@pytest.fixture
def config(survey_folder, tmp_path):
    base = AerialConfig(dataset=str(survey_folder), runs=str(tmp_path / "runs"), threads=1)
    settings = {field.name: getattr(base, field.name) for field in fields(AerialConfig)}
    settings |= {"camera": CarCameraConfig(width=WIDTH, height=HEIGHT), "name": "tiny"}
    return FakeCarConfig(
        **settings, trajectory="outer_loop", laps=1, seconds=14.0, car_file=str(ROOT / "configs/cars/mini_city.yaml")
    )


def test_a_policy_that_was_not_exported_is_named(config):
    with pytest.raises(UserError, match=r"policy\.onnx: no such policy; run make demo-aerial"):
        policy_file(config)


def test_one_policy_drives_through_the_bridge_and_without(config, tmp_path):
    file = tmp_path / "runs/tiny/policies/outer_loop/ours/0/policy.onnx"
    file.parent.mkdir(parents=True)
    trial_policy(file, "constant", WIDTH, HEIGHT, value=0.0)
    found = drive_both(config, tmp_path / "laps")
    bridge, simulator = found["bridge"], found["simulator"]
    assert found["trajectory"] == "outer_loop"
    # straight on for a few seconds at 0.8 m/s: the car drove, and left the road at the first curve as it does without
    assert bridge["distance"] > 1 and bridge["faults"] == []
    assert simulator["laps"] == 1 and simulator["interventions"] >= 4
    assert 0 < bridge["position_rmse"] < 0.2
