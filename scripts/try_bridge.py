"""Try the bridge on the rig as a sceptic would, and write what was measured for scripts/report_bridge.py.

python scripts/try_bridge.py --config configs/aerial2ground/fast.yaml      all parts; about half an hour
python scripts/try_bridge.py --parts '[faults]' --repetitions 1            one part, once
"""

import json
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from aerial2ground.bridge.fake_car import FakeCarConfig
from aerial2ground.bridge.try_parts import PARTS
from hashnerf.command_line import parse_config, run_main
from hashnerf.errors import UserError
from hashnerf.run_info import commit, machine

Part = Literal["faults", "period", "noise", "latency", "laps", "chart", "coverage"]


@dataclass(frozen=True)
class TryConfig(FakeCarConfig):
    """The simulated car's config, and what is tried."""

    laps: int = 5
    """Laps that the hardware in the loop drives of each trajectory."""
    parts: tuple[Part, ...] = ("faults", "period", "noise", "latency", "laps", "chart", "coverage")
    """What is tried."""
    repetitions: int = 20
    """Times that each fault is done."""
    duration: float = 60.0
    """Seconds over which the period is measured."""
    noise: int = 1_000_000
    """Bytes of noise."""
    results: Path = Path("runs/bridge_evidence")
    """Folder of the figures, one JSON file a part."""

    def __post_init__(self):
        super().__post_init__()
        for key in ("repetitions", "duration", "noise"):
            if not getattr(self, key) > 0:
                raise UserError(f"{key} is {getattr(self, key)}; give a positive number")


def main() -> None:
    """Try every part and write its figures."""
    config = parse_config(TryConfig, description="Try the bridge on the rig.")
    config.results.mkdir(parents=True, exist_ok=True)
    for part in config.parts:
        with tempfile.TemporaryDirectory() as folder:
            found = PARTS[part](config, Path(folder))
        about = {"commit": commit(), "machine": machine()}
        (config.results / f"{part}.json").write_text(json.dumps(about | {"found": found}, indent=1), encoding="utf-8")
        print(f"{config.results / part}.json written", flush=True)


if __name__ == "__main__":
    run_main(main)
