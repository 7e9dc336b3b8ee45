"""Stage 3 of CARFF: train the forecast (mixture density network) on the beliefs of stage 1.

python scripts/train_mdn.py --config configs/carff/fast.yaml [--mdn.steps 2000] [--name my_run]
"""

from carff.config import CarffConfig
from carff.stages import run_mdn
from hashnerf.command_line import parse_config, run_main


def main() -> None:
    """Train, or continue where an earlier call stopped."""
    run_mdn(
        parse_config(
            CarffConfig,
            description="Stage 3 of CARFF: train the forecast (mixture density network) on the beliefs of stage 1.",
        )
    )


if __name__ == "__main__":
    run_main(main)
