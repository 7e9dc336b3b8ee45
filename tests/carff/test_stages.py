"""What the stages share: the device, and encoding views with gaps. The stages themselves run in tests/e2e."""

from dataclasses import replace

import pytest
import torch

from carff import stages
from carff.config import CarffConfig
from carff.encoders import EncoderConfig
from carff.nerf import NerfConfig
from carff.nerf_training import training_views
from carff.pcvae import PcvaeConfig
from carff.scene_info import scene_info
from carff.stages import device_of, encode_views, new_pcvae, run_mdn, run_nerf, settled
from hashnerf.command_line import plain_config, save_config
from hashnerf.errors import UserError
from hashnerf.field import FieldConfig
from hashnerf.fit import FitConfig
from hashnerf.marching import MarchSettings


def test_auto_takes_the_gpu_if_there_is_one():
    assert device_of(CarffConfig()).type == ("cuda" if torch.cuda.is_available() else "cpu")
    assert device_of(CarffConfig(device="cpu")).type == "cpu"


def test_a_missing_view_is_invalid_and_the_others_are_in_place(tiny_data, tiny_table):
    torch.manual_seed(0)
    config = CarffConfig(device="cpu", pcvae=PcvaeConfig(encoder=EncoderConfig(width=8)))
    pcvae = new_pcvae(config, scene_info(tiny_data, tiny_table))
    index = tiny_table.views.clone()
    index[2, 1] = -1
    beliefs = encode_views(pcvae, tiny_data, index)
    assert not beliefs.valid[2, 1] and beliefs.valid.sum() == 15
    alone = pcvae.encode(tiny_data.images[index[3, 2]][None])
    assert torch.allclose(beliefs.means[3, 2], alone.mean[0], atol=2e-2)


def test_an_encoder_that_broke_down_is_refused_before_the_next_stage(tiny_data, tiny_table):
    torch.manual_seed(0)
    config = CarffConfig(device="cpu", pcvae=PcvaeConfig(encoder=EncoderConfig(width=8)))
    pcvae = new_pcvae(config, scene_info(tiny_data, tiny_table))
    with torch.no_grad():
        pcvae.encoder.head[-1].bias[0] = 1e18
    with pytest.raises(UserError, match="means of the encoded views: row 0"):
        encode_views(pcvae, tiny_data, tiny_table.views)


def test_a_pcvae_of_another_config_is_refused_by_key(tmp_path, monkeypatch, tiny_data, tiny_table):
    monkeypatch.setattr(stages, "load_data", lambda _: (tiny_data, tiny_table))
    config = CarffConfig(runs=str(tmp_path), device="cpu")
    (config.folder / "pcvae").mkdir(parents=True)
    save_config(stages._record(config, "pcvae"), config.folder / "pcvae" / "config.yaml")
    for stage in (run_nerf, run_mdn):
        with pytest.raises(UserError, match="no trained model here"):
            stage(config)
        with pytest.raises(UserError, match=r"trained with another config \(dataset: data/intersection -> data/b\)"):
            stage(replace(config, dataset="data/b"))


def test_the_last_steps_of_the_field_know_which_cameras_are_new(tmp_path, monkeypatch, tiny_data, tiny_table):
    torch.manual_seed(0)
    small = PcvaeConfig(encoder=EncoderConfig(width=8))
    config = CarffConfig(runs=str(tmp_path), device="cpu", pcvae=small, nerf=NerfConfig(birds_eye_steps=7))
    calls = []
    monkeypatch.setattr(stages, "load_data", lambda _: (tiny_data, tiny_table))
    monkeypatch.setattr(
        stages, "_pcvae_of_this_config", lambda *_: new_pcvae(config, scene_info(tiny_data, tiny_table))
    )
    monkeypatch.setattr(stages, "train_nerf", lambda *arguments: calls.append(arguments))
    monkeypatch.setattr(stages, "load_model", lambda *_: None)
    config.folder.mkdir()
    run_nerf(config)
    held_out = training_views(tiny_table, ("birds_eye",))
    (*_, steps, _, _), (*_, more, _, _, known) = calls
    assert (steps, more) == (config.nerf.steps, 7)
    assert torch.equal(known, held_out) and torch.equal(calls[1][3], training_views(tiny_table))


def test_a_trained_field_goes_on_gently():
    fit = FitConfig(learning_rate=0.1, network_learning_rate=0.01, final_share=0.1, seed=3)
    config = NerfConfig(fit=fit, march=MarchSettings(samples_per_opacity=12.0))
    further = settled(config)
    assert further.fit.learning_rate == pytest.approx(0.02)
    assert further.fit.network_learning_rate == pytest.approx(0.002)
    assert further.fit.first_samples_per_opacity == 12.0 and further.fit.seed == 4
    assert further.fresh_share(0) == 1.0 and further.field == config.field


def test_capacity_that_is_left_open_is_derived_once(tmp_path, monkeypatch, tiny_data, tiny_table, capsys):
    torch.manual_seed(0)
    small = PcvaeConfig(encoder=EncoderConfig(width=8))
    opened = NerfConfig(field=FieldConfig(levels=0, log2_table_size=0, finest_resolution=0))
    config = CarffConfig(runs=str(tmp_path), device="cpu", pcvae=small, nerf=opened)
    trained = []
    monkeypatch.setattr(stages, "load_data", lambda _: (tiny_data, tiny_table))
    monkeypatch.setattr(
        stages, "_pcvae_of_this_config", lambda *_: new_pcvae(config, scene_info(tiny_data, tiny_table))
    )
    monkeypatch.setattr(stages, "train_nerf", lambda own, *rest: trained.append(own))
    config.folder.mkdir()
    run_nerf(config)
    assert trained[0].field.levels > 0 and trained[0].march == NerfConfig().march
    assert f"{trained[0].field.levels} levels" in capsys.readouterr().err
    # a training that was begun keeps what it was begun with, whatever the pictures say now
    begun = replace(trained[0], field=replace(trained[0].field, levels=3))
    monkeypatch.setattr(stages, "begun_config", lambda *_: {"nerf": plain_config(begun)})
    run_nerf(config)
    assert trained[1].field.levels == 3 and "capacity" not in capsys.readouterr().err
