"""Measure a trained run and write its report: report.html to look at, report.json for programs.

python scripts/evaluate_carff.py --config configs/carff/fast.yaml [--name my_run]
python scripts/evaluate_carff.py --config configs/carff/fast.yaml --parts '[beliefs]'    # measures.json, no report
"""

import shlex
import sys
from dataclasses import dataclass
from pathlib import Path

from carff.config import CarffConfig
from carff.evaluation import evaluate
from carff.measured_parts import measure_parts
from hashnerf.command_line import parse_config, run_main
from hashnerf.report_page import print_targets


@dataclass(frozen=True)
class MeasureConfig(CarffConfig):
    """The pipeline's config, and whether single parts are measured without a report."""

    parts: tuple[str, ...] = ()
    """Only these are measured, into measures.json: beliefs, forecast, decisions; nothing: everything, with a report."""
    futures: int = 10
    """Sampled futures a decision where `parts` asks for decisions."""


def main() -> None:
    """Evaluate and print the figures that have targets."""
    config = parse_config(MeasureConfig, description="Measure a trained run and write its report.")
    if config.parts:
        print(measure_parts(config, config.parts, config.futures).read_text(encoding="utf-8"))
        return
    command = shlex.join(["python", f"scripts/{Path(sys.argv[0]).name}", *sys.argv[1:]])
    page = evaluate(config, command, lambda name, seconds: print(f"{name:12s}{seconds:7.1f} s", flush=True))
    print(f"report: {page}")
    print_targets(config.folder)


if __name__ == "__main__":
    run_main(main)
