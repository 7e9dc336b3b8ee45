"""A sweep over a script of three lines, for tests of everything that sweeps do."""

import textwrap
from pathlib import Path

import yaml

from hashnerf.sweep import Sweep, load_sweep

# Notes that it ran, refuses some widths, and writes what a measurement would: more steps are better, more width worse.
SCRIPT = """
import argparse, json, pathlib, sys
parser = argparse.ArgumentParser()
parser.add_argument("--config", action="append", default=[])
for name in ("runs", "name", "steps", "width", "part"):
    parser.add_argument("--" + name, default="1")
told = parser.parse_args()
folder = pathlib.Path(told.runs) / told.name
folder.mkdir(parents=True, exist_ok=True)
with (folder / "calls").open("a") as file:
    file.write(f"{told.part} {told.steps} {told.width} {told.config}\\n")
if told.width == "13":
    sys.exit("width is 13; give another")
steps, width = int(told.steps), float(told.width)
found = {"psnr": 20 + steps - width / 10, "seconds": steps * width, "parts": {"a": {"m": width}, "b": {"m": 3 * width}}}
(folder / (told.part + ".json")).write_text(json.dumps(found))
"""

FIGURE = {"file": "measure.json", "unit": "", "better": "less"}
PLAN = {
    "title": "A small sweep",
    "about": "What it is.",
    "stages": {"train": "fake.py --part train", "measure": "fake.py --part measure"},
    "timed": ["train"],
    "figures": {
        "seconds": FIGURE | {"key": "seconds", "unit": "s"},
        "quality": FIGURE | {"key": "psnr", "unit": "dB", "better": "more"},
        "mean": FIGURE | {"key": "parts.*.m", "unit": "m"},
    },
    "cost": "seconds",
    "accuracy": "quality",
    "noise": 0.1,
    "knobs": {"steps": {"key": "steps", "values": [2, 1, 4]}, "width": {"key": "width", "values": [1, 3]}},
    "pareto": {"steps": [1, 4], "width": [3]},
    "presets": {"fast": 2.5, "balanced": 1.5, "accurate": 0.0},
}


def write_sweep(folder: Path, **changes: object) -> Path:
    """Writes the sweep with some parts changed (None: left out), and the script beside it."""
    (folder / "fake.py").write_text(textwrap.dedent(SCRIPT))
    (folder / "sweeps").mkdir(exist_ok=True)
    path = folder / "sweeps" / "small.yaml"
    plan = {key: value for key, value in (PLAN | changes).items() if value is not None}
    path.write_text(yaml.dump(plan, Dumper=_Plain, sort_keys=False))
    return path


def small_sweep(folder: Path, **changes: object) -> Sweep:
    """Returns the sweep with some parts changed."""
    return load_sweep(write_sweep(folder, **changes))


def calls(folder: Path) -> list[str]:
    """Returns what the script was told in a run's folder, a line a call."""
    return (folder / "calls").read_text().splitlines()


class _Plain(yaml.SafeDumper):
    def ignore_aliases(self, data: object) -> bool:
        return True
