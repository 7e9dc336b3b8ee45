"""A radiance field of posed photographs: train, and measure on those held out. Capacity is derived from the pictures.

python scripts/train_static_nerf.py --dataset FOLDER --name my_scene [--image_size 400] [--steps 3000]
"""

import json

from hashnerf.command_line import parse_config, run_main
from hashnerf.static_scene import StaticConfig, train_static


def main() -> None:
    """Train or continue, measure and print."""
    config = parse_config(StaticConfig, description="A radiance field of posed photographs.")
    print(json.dumps(train_static(config), indent=1))
    print(f"{config.folder}: reconstruction.json, held_out.png")


if __name__ == "__main__":
    run_main(main)
