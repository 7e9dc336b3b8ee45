"""Stage 2 of the baselines: a person drives every trajectory in the town as it is now and collects pictures.

python scripts/collect_drives.py --config configs/aerial2ground/fast.yaml
"""

from aerial2ground.config import AerialConfig
from aerial2ground.learning_stages import run_drives
from hashnerf.command_line import parse_config, run_main


def main() -> None:
    """Drive, where that has not been done."""
    config = parse_config(AerialConfig, description="Collect pictures by driving, for the baselines.")
    run_drives(config)
    print(f"{config.drives}: collected pictures are there")


if __name__ == "__main__":
    run_main(main)
