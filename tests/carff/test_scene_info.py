"""What a run keeps of its data set: written and read back whole."""

import json

import pytest
import torch

from carff.scene_info import load_scene_info, scene_info
from hashnerf.errors import UserError


def test_round_trip(tiny_data, tiny_table, tmp_path):
    info = scene_info(tiny_data, tiny_table)
    info.save(tmp_path / "scene.json")
    back = load_scene_info(tmp_path / "scene.json")
    assert back.states == info.states == ((0, 0), (0, 1), (1, 0), (1, 1))
    assert torch.equal(back.successor, torch.tensor([1, -1, 3, -1]))
    assert torch.equal(back.known_hazard(), torch.tensor([False, False, True, True]))
    assert back.actors == info.actors
    assert torch.equal(back.cameras.pose, info.cameras.pose)
    assert back.cameras_of("birds_eye") == [3]
    assert torch.equal(back.scene_box, tiny_data.scene_box)


def test_one_camera_row_per_camera_number(tiny_data, tiny_table):
    info = scene_info(tiny_data, tiny_table)
    assert len(info.cameras) == 4
    assert torch.equal(info.cameras.pose, tiny_table.camera_poses)


def test_hazards_that_nobody_stated_are_a_sentence(tiny_data, tiny_table, tmp_path):
    info = scene_info(tiny_data, tiny_table)
    info.save(tmp_path / "scene.json")
    plain = json.loads((tmp_path / "scene.json").read_text())
    plain["hazard"] = None
    (tmp_path / "scene.json").write_text(json.dumps(plain))
    with pytest.raises(UserError, match="add `hazard`"):
        load_scene_info(tmp_path / "scene.json").known_hazard()


def test_a_foreign_file_is_a_sentence(tmp_path):
    (tmp_path / "scene.json").write_text('{"states": [[0, 0]]}')
    with pytest.raises(UserError, match="not written by a training run"):
        load_scene_info(tmp_path / "scene.json")
    with pytest.raises(UserError, match="no such file"):
        load_scene_info(tmp_path / "nothing.json")
