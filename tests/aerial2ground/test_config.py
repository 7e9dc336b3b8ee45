"""The config of the pipeline and the presets that come with it."""

from pathlib import Path

import pytest

from aerial2ground.config import AerialConfig
from hashnerf.command_line import load_config

PRESETS = sorted((Path(__file__).resolve().parents[2] / "configs" / "aerial2ground").glob("*.yaml"))


@pytest.mark.parametrize("preset", PRESETS, ids=lambda path: path.stem)
def test_presets_load(preset):
    config = load_config(AerialConfig, preset)
    assert config.folder == Path("runs") / config.name and config.dataset.startswith("data/")
