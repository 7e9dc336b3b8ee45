"""Stage 3 of aerial2ground: networks that steer along each path, learned from ground views.

python scripts/train_policy.py --config configs/aerial2ground/fast.yaml
"""

from aerial2ground.config import AerialConfig
from aerial2ground.stages import run_policies
from hashnerf.command_line import parse_config, run_main


def main() -> None:
    """Train one network per trajectory."""
    config = parse_config(AerialConfig, description="Train the steering networks.")
    run_policies(config)
    print(f"{config.folder / 'policies'}: trained")


if __name__ == "__main__":
    run_main(main)
