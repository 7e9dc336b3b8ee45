"""Write the report of a run of aerial2ground from what its stages have measured: report.html and report.json.

python scripts/report_aerial.py --config configs/aerial2ground/fast.yaml [--name my_run]
"""

import shlex
import sys
from pathlib import Path

from aerial2ground.config import AerialConfig
from aerial2ground.report import write_run_report
from hashnerf.command_line import parse_config, run_main
from hashnerf.report_page import print_targets


def main() -> None:
    """Write the report and print the figures that have targets."""
    config = parse_config(AerialConfig, description="Write the report of a run from drone pictures to driving.")
    command = shlex.join(["python", f"scripts/{Path(sys.argv[0]).name}", *sys.argv[1:]])
    page = write_run_report(config, command)
    print(f"report: {page}")
    print_targets(config.folder)


if __name__ == "__main__":
    run_main(main)
