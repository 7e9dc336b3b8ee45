"""Stage 1 of CARFF: train the pose-conditional VAE on a data-set folder.

python scripts/train_pcvae.py --config configs/carff/fast.yaml [--pcvae.steps 2000] [--name my_run]
"""

from carff.config import CarffConfig
from carff.stages import run_pcvae
from hashnerf.command_line import parse_config, run_main


def main() -> None:
    """Train, or continue where an earlier call stopped."""
    run_pcvae(
        parse_config(CarffConfig, description="Stage 1 of CARFF: train the pose-conditional VAE on a data-set folder.")
    )


if __name__ == "__main__":
    run_main(main)
