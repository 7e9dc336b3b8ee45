"""Reconstruct a real place from drone photographs and measure it on those held out.

python scripts/evaluate_survey.py --config configs/aerial2ground/caliterra.yaml --data FOLDER
"""

import json
from dataclasses import dataclass, fields

from aerial2ground.config import AerialConfig
from aerial2ground.evaluate_survey import evaluate_survey
from hashnerf.command_line import parse_config, run_main


@dataclass(frozen=True)
class SurveyRunConfig(AerialConfig):
    """The pipeline's config, with the folder to work on."""

    data: str = ""
    """Folder of the photographs with their transforms.json; empty: `dataset`."""


def main() -> None:
    """Train or continue, measure and print."""
    told = parse_config(SurveyRunConfig, description="Reconstruct a real place from drone photographs.")
    values = {field.name: getattr(told, field.name) for field in fields(AerialConfig)}
    config = AerialConfig(**values | {"dataset": told.data or told.dataset})
    print(json.dumps(evaluate_survey(config), indent=1))
    print(f"{config.folder}: reconstruction.json, held_out.png, road_views.png")


if __name__ == "__main__":
    run_main(main)
