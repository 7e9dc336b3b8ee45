"""The config of the pipeline and the presets that come with it."""

from pathlib import Path

import pytest

from aerial2ground.config import AerialConfig
from hashnerf.command_line import load_config
from hashnerf.errors import UserError

FOLDER = Path(__file__).resolve().parents[2] / "configs" / "aerial2ground"
PRESETS = [path for path in sorted(FOLDER.glob("*.yaml")) if not path.stem.startswith("recording")]


@pytest.mark.parametrize("preset", PRESETS, ids=lambda path: path.stem)
def test_presets_load(preset):
    config = load_config(AerialConfig, preset)
    assert config.folder == Path("runs") / config.name and config.dataset.startswith("data/")


@pytest.mark.parametrize(
    "changes, sentence",
    [
        ({"scene_box": (0.0, 0.0, 0.0, 1.0, 1.0)}, "scene_box is"),
        ({"scene_box": (0.0, 0.0, 5.0, 1.0, 1.0, 2.0)}, "with x0 < x1"),
        ({"scene_box": (0.0, 0.0, 0.0)}, "scene_box is"),
        ({"test_every": 1}, "test_every is 1"),
        ({"test_every": -8}, "test_every is -8"),
    ],
)
def test_bad_settings_are_named(changes, sentence):
    with pytest.raises(UserError, match=sentence):
        AerialConfig(**changes)
