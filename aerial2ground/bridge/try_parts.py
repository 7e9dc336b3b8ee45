"""The parts of scripts/try_bridge.py: each takes the config and an empty folder, and returns what JSON can hold."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from aerial2ground.bridge.drive_chart import drive_chart
from aerial2ground.bridge.endurance import noise, period, steepest_rates
from aerial2ground.bridge.laps import drive_both, policy_file
from aerial2ground.bridge.latency_budget import budget, stage_times
from aerial2ground.bridge.replay import read_log, replay
from aerial2ground.bridge.rig import ROOT, Rig
from aerial2ground.bridge.trials import TRIALS, Trial, repeat
from aerial2ground.stages import load_driven_survey
from hashnerf.errors import UserError
from hashnerf.figure_style import png_bytes
from hashnerf.transforms_json import write_atomically

CHART = "drive.png"


def try_faults(config: Any, folder: Path) -> list[dict]:
    """Every fault, so often: seconds to the first brake frame."""
    found = []
    for trial in TRIALS:

        def make_rig(trial: Trial, number: int) -> Rig:
            return Rig(folder / f"{trial.name}{number}", policy=trial.policy)

        took = repeat(trial, make_rig, config.repetitions)
        found.append({"name": trial.name, "what": trial.what, "allowed": trial.allowed, "took": took})
        print(f"{trial.name}: {1000 * max(took):.0f} ms at most, {1000 * trial.allowed:.0f} allowed", flush=True)
    return found


def try_period(config: Any, folder: Path) -> list[dict]:
    """The period beside one and two busy processes, and the steepest set-points."""
    found = []
    for busy in (1, 2):
        with Rig(folder / str(busy)) as rig:
            rig.confirm_wheels()
            found.append(asdict(period(rig, config.duration, busy)))
            print(found[-1], flush=True)
    return found


def try_noise(config: Any, folder: Path) -> dict:
    """A million bytes of noise on the reply path."""
    with Rig(folder) as rig:
        rig.confirm_wheels()
        found = asdict(noise(rig, config.noise))
        return found | steepest_rates(rig.vesc.received, rig.vesc.motor.car)


def try_latency(config: Any, folder: Path) -> list[list]:
    """Half a minute with the trained policy: where the time goes."""
    with Rig(folder, policy=policy_file(config)) as rig:
        rig.confirm_wheels()
        rig.arm()
        rig.vesc.take()
        time.sleep(config.duration / 2)
        received, shown = rig.vesc.take(), dict(rig.picture.times)
        rig.say("quit")
        rig.bridge.wait()
    return [list(line) for line in budget(stage_times(read_log(next((folder / "log").iterdir())), shown, received))]


def try_laps(config: Any, folder: Path) -> list[dict]:
    """Laps of every trajectory with the hardware in the loop, and without.

    Raises UserError, after all were driven, where a fault ended one.
    """
    found = []
    for name in load_driven_survey(config).trajectories:
        found.append(drive_both(replace(config, trajectory=name), folder / name))
        print(_sentence(found[-1]), flush=True)
    if any(one["bridge"]["faults"] for one in found):
        raise UserError("a fault ended the laps (above): drive them again on a computer that has nothing else to do")
    return found


def _sentence(laps: Mapping) -> str:
    drive, alone = laps["bridge"], laps["simulator"]
    ended = f"; ENDED BY {drive['faults'][0]}" if drive["faults"] else ""
    return (
        f"{laps['trajectory']}: {drive['laps']} laps in {drive['seconds']:.0f} s, {drive['interventions']} "
        f"interventions, {100 * (drive['position_rmse'] or 0):.1f} cm off (in the simulator alone "
        f"{alone['interventions']} and {100 * alone['position_rmse']:.1f} cm){ended}"
    )


def try_chart(config: Any, folder: Path) -> str:
    """A drive with a frozen camera and an emergency stop, drawn from its black box into `config.results`."""
    with Rig(folder, policy="brightness") as rig:
        rig.confirm_wheels()
        rig.arm()
        time.sleep(1)
        rig.stream.freeze("still")
        time.sleep(1.2)
        rig.stream.resume()
        rig.hold(False)
        time.sleep(1)
        rig.arm()
        time.sleep(0.7)
        rig.press(" ")
        time.sleep(0.8)
        rig.say("quit")
        rig.bridge.wait()
    log = next((folder / "log").iterdir())
    write_atomically(config.results / CHART, png_bytes(drive_chart(read_log(log))))
    again = replay(log)
    return f"{again.periods} periods, {again.different} of them with other bytes when replayed"


def try_coverage(config: Any, folder: Path) -> dict:
    """How much of the guard its tests reach, branches included."""
    options = ["run", "--branch", f"--source={ROOT / 'aerial2ground/guard'}", "-m", "pytest", "-q", "-o"]
    options += ["addopts=--import-mode=importlib", "-p", "no:cacheprovider", str(ROOT / "tests/aerial2ground/guard")]
    environment = os.environ | {"COVERAGE_FILE": str(folder / "data"), "PYTHONPATH": str(ROOT)}
    for command in (options, ["json", "-o", str(folder / "coverage.json")]):
        subprocess.run([sys.executable, "-m", "coverage", *command], cwd=ROOT, env=environment, check=True)
    totals = json.loads((folder / "coverage.json").read_text(encoding="utf-8"))["totals"]
    return {"percent": totals["percent_covered"], "lines": totals["num_statements"], "branches": totals["num_branches"]}


PARTS: Mapping[str, Callable[[Any, Path], Any]] = {
    "faults": try_faults,
    "period": try_period,
    "noise": try_noise,
    "latency": try_latency,
    "laps": try_laps,
    "chart": try_chart,
    "coverage": try_coverage,
}
