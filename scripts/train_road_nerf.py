"""Stage 1 of aerial2ground: a radiance field of the town from drone pictures, with what is known of its roads.

python scripts/train_road_nerf.py --config configs/aerial2ground/fast.yaml
python scripts/train_road_nerf.py --config configs/aerial2ground/fast.yaml --pictures drives   # for the baselines
"""

from aerial2ground.config import PicturesConfig
from aerial2ground.stages import run_reconstruction
from hashnerf.command_line import parse_config, run_main


def main() -> None:
    """Train, or continue where an earlier call stopped."""
    run_reconstruction(parse_config(PicturesConfig, description="Reconstruct a town from pictures.").source)


if __name__ == "__main__":
    run_main(main)
