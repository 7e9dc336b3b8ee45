"""Runs the scripts of the pipeline one after another, each in a process of its own, and notes time and memory.

A process per stage keeps one stage's memory out of the next one's figures, and a stage that is interrupted is continued
by running the same command again: finished stages say so and end at once.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from hashnerf.errors import UserError
from hashnerf.transforms_json import read_transforms, write_atomically

TIMINGS = "timings.json"


def read_timings(folder: Path) -> dict[str, dict]:
    """Returns what earlier calls noted: stage name -> {seconds, peak_memory_mb}."""
    path = folder / TIMINGS
    return read_transforms(path)["stages"] if path.is_file() else {}


def run_stage(name: str, command: Sequence[str], folder: Path) -> None:
    """Runs one script and adds its time and peak memory to the run's timings; a failing script ends this one alike."""
    print(f"\n== {name}", flush=True)
    start = time.monotonic()
    process = subprocess.Popen([sys.executable, *command])
    try:
        _, status, usage = os.wait4(process.pid, 0)
    except KeyboardInterrupt:
        # The terminal has sent Ctrl-C to the stage as well; it saves and ends by itself.
        _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise SystemExit(process.returncode if process.returncode > 0 else 128 - process.returncode)
    unit = 1e6 if sys.platform == "darwin" else 1e3
    note(folder, name, time.monotonic() - start, usage.ru_maxrss / unit)


def note(folder: Path, name: str, seconds: float, peak_memory_mb: float) -> None:
    """Adds a stage's cost to the timings; a stage that was continued adds up."""
    stages = read_timings(folder)
    earlier = stages.get(name, {"seconds": 0.0, "peak_memory_mb": 0.0})
    stages[name] = {
        "seconds": round(earlier["seconds"] + seconds, 2),
        "peak_memory_mb": round(max(earlier["peak_memory_mb"], peak_memory_mb), 1),
    }
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / TIMINGS, json.dumps({"stages": stages}, indent=1).encode())


def check_script_folder(scripts: Path) -> None:
    """Raises UserError where the scripts are not."""
    if not (scripts / "train_pcvae.py").is_file():
        raise UserError(f"{scripts}: the scripts are not here; run from a checkout of the repository")
