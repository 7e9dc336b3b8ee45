"""Stage 1 of aerial2ground: a radiance field of the town from drone pictures, with what is known of its roads.

python scripts/train_road_nerf.py --dataset data/mini_city --name mini_city
"""

from aerial2ground.config import AerialConfig
from aerial2ground.stages import run_reconstruction
from hashnerf.command_line import parse_config, run_main


def main() -> None:
    """Train, or continue where an earlier call stopped."""
    run_reconstruction(parse_config(AerialConfig, description="Reconstruct a town from drone pictures."))


if __name__ == "__main__":
    run_main(main)
