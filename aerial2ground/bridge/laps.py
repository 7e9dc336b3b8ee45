"""Laps of the town with the hardware in the loop: one policy through serial port and camera stream, and without."""

import json
import os
import subprocess
import sys
import time
from dataclasses import fields, replace
from pathlib import Path

from aerial2ground.bridge.fake_car import FakeCarConfig
from aerial2ground.bridge.rig import ROOT, BridgeProcess, deploy_command
from aerial2ground.evaluate_driving import drive_in
from aerial2ground.exported_policy import ExportedPolicy, load_exported
from aerial2ground.guard.faults import Fault
from aerial2ground.learning_stages import origin_of, policy_folder, town_of
from aerial2ground.stages import load_driven_survey
from hashnerf.command_line import save_config
from hashnerf.errors import UserError

NAMES = {fault.name for fault in Fault} - {Fault.LINK_LOST.name, Fault.POLICY_GONE.name}
METHOD, SEED = "ours", 0
"""The policy that has seen nothing from the ground."""


def policy_file(config: FakeCarConfig) -> Path:
    """Returns the policy that a run trained for a trajectory; raises UserError where it is not exported."""
    file = policy_folder(config, config.trajectory, METHOD, SEED) / "policy.onnx"
    if not file.is_file():
        raise UserError(f"{file}: no such policy; run make demo-aerial and scripts/export_policy.py first")
    return file


def drive_both(config: FakeCarConfig, folder: Path) -> dict:
    """Drives `config.laps` laps through the bridge and as many without it; returns what happened, as JSON has it."""
    policy = policy_file(config)
    bridge = drive_bridge(config, policy, folder)
    return {
        "trajectory": config.trajectory,
        "bridge": bridge,
        "simulator": drive_simulator(config, load_exported(policy)),
    }


def drive_simulator(config: FakeCarConfig, policy: ExportedPolicy) -> dict:
    """Drives with nothing in between, at the nominal speed everywhere: that is what the bridge does."""
    survey = load_driven_survey(config)
    path = survey.trajectories[config.trajectory]
    constant = replace(config, pure_pursuit=replace(config.pure_pursuit, slow_speed=config.pure_pursuit.speed))
    drive = drive_in(
        constant,
        town_of(config, survey),
        origin_of(survey),
        lambda picture, state: policy(picture),
        path,
        config.seed,
        config.laps,
    )
    return {
        "laps": config.laps,
        "interventions": drive.interventions,
        "position_rmse": round(drive.position_rmse, 5),
        "yaw_rmse": round(drive.yaw_rmse, 5),
    }


def drive_bridge(config: FakeCarConfig, policy: Path, folder: Path) -> dict:
    """Drives through a fake controller and a camera stream in a process of their own; returns its summary."""
    folder.mkdir(parents=True, exist_ok=True)
    out = folder / "summary.json"
    settings = {field.name: getattr(config, field.name) for field in fields(FakeCarConfig)}
    save_config(FakeCarConfig(**settings | {"out": str(out), "link": ""}), folder / "fake_vesc.yaml")
    command = [sys.executable, str(ROOT / "scripts/fake_vesc.py"), "--config", str(folder / "fake_vesc.yaml")]
    fake = subprocess.Popen(
        command,
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        port, camera = (fake.stdout.readline().partition(": ")[2].strip() for _ in range(2))
        if not camera:
            raise UserError("scripts/fake_vesc.py did not start; its own words stand above")
        start = deploy_command(policy, port, camera, Path(config.car_file))
        with BridgeProcess([*start, "--speed", str(config.pure_pursuit.speed), "--log", str(folder / "log")]) as bridge:
            bridge.confirm_wheels()
            bridge.arm()
            while fake.poll() is None and bridge.said("FAULT") is None:
                time.sleep(0.1)
            # that the controller goes when the laps are driven is no fault
            faults = [line for _, line in bridge.heard if line.split(":")[0] in NAMES]
    finally:
        fake.terminate()
        fake.communicate()
    return json.loads(out.read_text(encoding="utf-8")) | {"faults": faults}


def extra_interventions(result: dict) -> int:
    """How many more interventions the bridge needed than the simulator."""
    return result["bridge"]["interventions"] - result["simulator"]["interventions"]
