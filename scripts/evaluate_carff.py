"""Measure a trained run and write its report: report.html to look at, report.json for programs.

python scripts/evaluate_carff.py --config configs/carff/fast.yaml [--name my_run]
"""

import shlex
import sys
from pathlib import Path

from carff.config import CarffConfig
from carff.evaluation import evaluate
from hashnerf.command_line import parse_config, run_main
from hashnerf.report_page import print_targets


def main() -> None:
    """Evaluate and print the figures that have targets."""
    config = parse_config(CarffConfig, description="Measure a trained run and write its report.")
    command = shlex.join(["python", f"scripts/{Path(sys.argv[0]).name}", *sys.argv[1:]])
    page = evaluate(config, command, lambda name, seconds: print(f"{name:12s}{seconds:7.1f} s", flush=True))
    print(f"report: {page}")
    print_targets(config.folder)


if __name__ == "__main__":
    run_main(main)
