"""Measure a trained run and write its report: report.html to look at, report.json for programs.

python scripts/evaluate_carff.py --config configs/carff/fast.yaml [--name my_run]
"""

import json
import shlex
import sys
from pathlib import Path

from carff.config import CarffConfig
from carff.evaluation import evaluate
from hashnerf.command_line import parse_config, run_main


def main() -> None:
    """Evaluate and print the figures that have targets."""
    config = parse_config(CarffConfig, description="Measure a trained run and write its report.")
    command = shlex.join(["python", f"scripts/{Path(sys.argv[0]).name}", *sys.argv[1:]])
    page = evaluate(config, command, lambda name, seconds: print(f"{name:12s}{seconds:7.1f} s", flush=True))
    report = json.loads((config.folder / "report.json").read_text(encoding="utf-8"))
    for row in report["targets"]:
        value = "not run" if row["measured"] is None else f"{row['measured']:.4g}"
        verdict = {True: "met", False: "missed", None: ""}[row["met"]]
        print(f"{row['key']:34s}{value:>10s}  {verdict}")
    print(f"report: {page}")


if __name__ == "__main__":
    run_main(main)
