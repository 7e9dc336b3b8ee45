"""Stage 3 of aerial2ground: networks that steer along each path, learned from ground views.

python scripts/train_policy.py --config configs/aerial2ground/fast.yaml
"""

from rich.progress import Progress

from aerial2ground.config import AerialConfig
from aerial2ground.learning_stages import run_policies
from hashnerf.command_line import parse_config, run_main


def main() -> None:
    """Train a network for every trajectory, method and seed."""
    config = parse_config(AerialConfig, description="Train the steering networks.")
    with Progress(transient=True) as progress:
        task = progress.add_task("networks")
        run_policies(config, lambda done, total: progress.update(task, completed=done, total=total))
    print(f"{config.folder / 'policies'}: trained")


if __name__ == "__main__":
    run_main(main)
