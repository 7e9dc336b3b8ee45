"""The pipeline's config: every preset and layer in the repository parses, bad values are named."""

from pathlib import Path

import pytest

from carff.config import CarffConfig, EvaluationConfig
from hashnerf.command_line import load_config, parse_config
from hashnerf.errors import UserError

PRESETS = Path(__file__).resolve().parents[2] / "configs" / "carff"


@pytest.mark.parametrize("path", sorted(PRESETS.glob("*.yaml")), ids=lambda path: path.stem)
def test_presets_parse(path):
    assert load_config(CarffConfig, path).name


def test_layers_win_over_presets_and_arguments_over_layers():
    fast, layer = str(PRESETS / "fast.yaml"), str(PRESETS / "two_lane_merge.yaml")
    config = parse_config(CarffConfig, ["--config", fast, "--config", layer, "--pcvae.steps", "7"])
    assert config.dataset == "data/two_lane_merge"
    assert config.pcvae.steps == 7
    assert config.evaluation.preset == "fast"


def test_run_folder_refuses_names_that_leave_it():
    with pytest.raises(UserError, match="cannot name a run"):
        _ = CarffConfig(name="../elsewhere").folder


def test_bad_values_are_named():
    with pytest.raises(UserError, match=r"evaluation.episodes is 0"):
        EvaluationConfig(episodes=0)
    with pytest.raises(UserError, match="threads is -1"):
        CarffConfig(threads=-1)


@pytest.mark.parametrize(
    "key, value",
    [
        ("nerf.fit.average_decay", "5"),
        ("nerf.fit.learning_rate", "-1"),
        ("nerf.march.near", "-1"),
        ("nerf.field.initial_thickness", "-1"),
        ("nerf.birds_eye_steps", "-5"),
        ("probe.min_confidence", "5"),
        ("pcvae.kl_end", "-1"),
        ("pcvae.encoder.width", "7"),
    ],
)
def test_a_bad_value_is_named_with_its_whole_key(key, value):
    with pytest.raises(UserError, match=rf"^{key} is {value}(\.0)?\b"):
        parse_config(CarffConfig, [f"--{key}", value])
