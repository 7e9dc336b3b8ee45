"""Align a drone's pictures with each other before training: a copy of a data set with better poses.

python scripts/align_survey.py --dataset data/mini_city --out data/mini_city_aligned

For surveys whose poses are wrong by centimetres and degrees, over flat ground with a road network. Say how wrong they
may be with --alignment.position_std (m) and --alignment.angle_std (degrees).
"""

from dataclasses import dataclass, field
from pathlib import Path

from aerial2ground.survey_alignment import AlignmentConfig, align_folder
from hashnerf.command_line import parse_config, run_main, set_threads


@dataclass(frozen=True)
class AlignConfig:
    """What to align."""

    dataset: str
    """Folder of the drone's pictures."""
    out: str
    """Folder to write."""
    threads: int = 0
    """Processor threads; 0 uses all cores."""
    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    """How it is done."""


def main() -> None:
    """Align and say how well the pictures agree."""
    config = parse_config(AlignConfig, description="Align a drone's pictures with each other.")
    set_threads(config.threads)

    def tell(number: int, sightings: int, median: float) -> None:
        print(f"round {number}: {sightings} sightings of the ground agree within {median:.2f} px (median)", flush=True)

    kept = align_folder(Path(config.dataset), Path(config.out), config.alignment, tell).kept
    if kept:
        print(f"{len(kept)} pictures keep their told pose, too little ground ties them: kept_as_told in alignment.json")
    print(f"{config.out}: written; train on it with --dataset {config.out}")


if __name__ == "__main__":
    run_main(main)
