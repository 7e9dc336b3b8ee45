"""A radiance field of posed photographs: train, and measure on those held out. Capacity is derived from the pictures.

python scripts/train_static_nerf.py --dataset FOLDER --name my_scene --config configs/static/balanced.yaml
python scripts/train_static_nerf.py --dataset FOLDER --name my_scene --image_size 400 --max_seconds 120
"""

import json
from dataclasses import dataclass, fields
from pathlib import Path

from hashnerf.command_line import load_config, parse_config, run_main
from hashnerf.errors import UserError
from hashnerf.progress import say
from hashnerf.static_budget import within_seconds
from hashnerf.static_scene import StaticConfig, train_static

PRESETS = ("fast", "balanced", "accurate")
CONFIGS = Path(__file__).resolve().parents[1] / "configs" / "static"


@dataclass(frozen=True)
class ScriptConfig(StaticConfig):
    """A radiance field of one data-set folder, and how long it may take."""

    max_seconds: float = 0.0
    """Takes the steps of the best of the presets fast, balanced and accurate whose training fits here, in place of
    `steps`; 0: no limit."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.max_seconds < 0:
            raise UserError(f"max_seconds is {self.max_seconds:g}; give a number of seconds, or 0 for no limit")


def main() -> None:
    """Train or continue, measure and print."""
    told = parse_config(ScriptConfig, description="A radiance field of posed photographs.")
    config = StaticConfig(**{field.name: getattr(told, field.name) for field in fields(StaticConfig)})
    if told.max_seconds:
        presets = {name: load_config(StaticConfig, CONFIGS / f"{name}.yaml").steps for name in PRESETS}
        config, reason = within_seconds(config, presets, told.max_seconds)
        say(reason)
    print(json.dumps(train_static(config), indent=1))
    print(f"{config.folder}: reconstruction.json, held_out.png")


if __name__ == "__main__":
    run_main(main)
