"""Check a data-set folder as the trainings do, without training: what is wrong with it, or what it is enough for.

python scripts/check_dataset.py --dataset data/junction
"""

from dataclasses import dataclass
from pathlib import Path

from carff.dataset_summary import summarise
from carff.states import build_state_table
from hashnerf.command_line import parse_config, run_main
from hashnerf.errors import UserError
from hashnerf.posed_images import load_posed_images


@dataclass(frozen=True)
class CheckConfig:
    """Check a data set."""

    dataset: str
    """Folder with transforms.json and images."""


def main() -> None:
    """Load the folder and say what it holds."""
    config = parse_config(CheckConfig, description="Check a data-set folder without training.")
    data = load_posed_images(Path(config.dataset))
    for line in summarise(data, build_state_table(data)):
        print(line)
    if all(frame.split != "train" for frame in data.frames):
        raise UserError(f"{config.dataset}: nothing can be trained; give cameras the split `train`")


if __name__ == "__main__":
    run_main(main)
