"""How good a town's reconstruction is: held-out drone pictures, corrected poses, and views from the ground.

python scripts/evaluate_reconstruction.py --config configs/aerial2ground/fast.yaml
"""

import json
from dataclasses import dataclass

from aerial2ground.config import AerialConfig
from aerial2ground.evaluate_reconstruction import evaluate_run
from hashnerf.command_line import parse_config, run_main


@dataclass(frozen=True)
class MeasureConfig(AerialConfig):
    """The pipeline's config, and what to measure."""

    aerial: bool = True
    """Measure the held-out drone pictures too, which takes most of the time."""


def main() -> None:
    """Measure and print."""
    config = parse_config(MeasureConfig, description="Measure a town's reconstruction.")
    print(json.dumps(evaluate_run(config, config.aerial), indent=1))


if __name__ == "__main__":
    run_main(main)
