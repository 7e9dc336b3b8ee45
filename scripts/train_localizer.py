"""Stage 3 of aerial2ground: networks that tell the car's pose from one picture, learned from ground views.

python scripts/train_localizer.py --config configs/aerial2ground/fast.yaml
"""

from rich.progress import Progress

from aerial2ground.config import AerialConfig
from aerial2ground.learning_stages import run_localisers
from hashnerf.command_line import parse_config, run_main


def main() -> None:
    """Train a network for every method and seed."""
    config = parse_config(AerialConfig, description="Train the networks that tell poses.")
    with Progress(transient=True) as progress:
        task = progress.add_task("networks")
        run_localisers(config, lambda done, total: progress.update(task, completed=done, total=total))
    print(f"{config.folder / 'localisers'}: trained")


if __name__ == "__main__":
    run_main(main)
