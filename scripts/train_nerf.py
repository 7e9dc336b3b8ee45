"""Stage 2 of CARFF: train the latent-conditioned radiance field on the beliefs of stage 1.

python scripts/train_nerf.py --config configs/carff/fast.yaml [--nerf.steps 2000] [--name my_run]
"""

from carff.config import CarffConfig
from carff.stages import run_nerf
from hashnerf.command_line import parse_config, run_main


def main() -> None:
    """Train, or continue where an earlier call stopped."""
    run_nerf(
        parse_config(
            CarffConfig,
            description="Stage 2 of CARFF: train the latent-conditioned radiance field on the beliefs of stage 1.",
        )
    )


if __name__ == "__main__":
    run_main(main)
