"""Loading a run: what its config is, and a folder that is none. A trained run is loaded in tests/e2e."""

from dataclasses import replace

import pytest

from carff.config import CarffConfig
from carff.mdn_training import MdnConfig
from carff.model import load_carff, trained_config
from carff.nerf import NerfConfig
from hashnerf.command_line import save_config
from hashnerf.errors import UserError


def test_a_folder_without_a_run_is_a_sentence(tmp_path):
    with pytest.raises(UserError, match=r"not a CARFF run \(no config\.yaml"):
        load_carff(tmp_path)


def test_a_run_of_another_kind_is_a_sentence(tmp_path):
    (tmp_path / "config.yaml").write_text("branch: 0\n")
    with pytest.raises(UserError, match=r"not a CARFF run \(no scene\.json"):
        load_carff(tmp_path)


def test_every_stage_keeps_the_config_it_was_trained_with(tmp_path):
    trained = CarffConfig(nerf=NerfConfig(supersample=3), mdn=MdnConfig(steps=7))
    last_called = replace(trained, nerf=NerfConfig(supersample=1), seed=5)
    for folder, config in ((tmp_path, last_called), (tmp_path / "nerf", trained), (tmp_path / "mdn", trained)):
        folder.mkdir(exist_ok=True)
        save_config(config, folder / "config.yaml")
    config = trained_config(tmp_path)
    assert config.nerf.supersample == 3 and config.mdn.steps == 7 and config.seed == 5
    assert config.folder == tmp_path
