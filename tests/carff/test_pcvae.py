"""The PC-VAE as a whole: shapes, sharp first beliefs, one picture alone equal to the same in a batch, config checks."""

import pytest
import torch

from carff.beliefs import Belief
from carff.decoders import DecoderConfig
from carff.encoders import EncoderConfig
from carff.pcvae import Pcvae, PcvaeConfig
from hashnerf.errors import UserError


def build(tiny_data, tiny_table, **settings) -> Pcvae:
    torch.manual_seed(0)
    config = PcvaeConfig(encoder=EncoderConfig(width=8), **settings)
    return Pcvae(config, tiny_table.camera_poses, tiny_data.scene_box, len(tiny_table), 32, 32)


def test_first_beliefs_are_sharp(tiny_data, tiny_table):
    belief = build(tiny_data, tiny_table).encode(tiny_data.images)
    assert belief.mean.shape == (16, 8)
    # The bias of the last layer is -4: standard deviations near e^-2 = 0.14.
    assert (belief.logvar + 4).abs().max() < 1.5


def test_encode_splits_into_batches_without_effect(tiny_data, tiny_table):
    pcvae = build(tiny_data, tiny_table)
    assert torch.allclose(pcvae.encode(tiny_data.images).mean, pcvae.encode(tiny_data.images, batch=3).mean, atol=2e-2)


@pytest.mark.parametrize("count", [1, 63, 64, 65, 128, 129])
def test_k45_every_picture_is_encoded_once_and_in_order(tiny_data, tiny_table, monkeypatch, count, numeric_row):
    """Pictures bear their number as their colour, and the encoder reads it."""
    pcvae = build(tiny_data, tiny_table)
    monkeypatch.setattr(pcvae, "encode_prepared", lambda x: Belief(x[:, 0, 0, :1].float(), torch.zeros(len(x), 1)))
    pictures = torch.arange(count, dtype=torch.uint8)[:, None, None, None].expand(count, 32, 32, 3)
    mean = pcvae.encode(pictures).mean[:, 0]
    wrong = abs(len(mean) - count) + int((mean[:count] != torch.arange(len(mean))[:count]).sum())
    numeric_row("K45", f"{count} pictures in batches of 64: latents missing, doubled or moved", wrong)


def test_encode_leaves_the_training_mode_as_it_was(tiny_data, tiny_table):
    pcvae = build(tiny_data, tiny_table).train()
    pcvae.encode(tiny_data.images)
    assert pcvae.training


@pytest.mark.parametrize("camera", ["one_hot", "pose"])
def test_conv_decoder_gives_pictures(tiny_data, tiny_table, camera):
    pcvae = build(tiny_data, tiny_table, decoder=DecoderConfig(kind="conv", camera=camera, width=32))
    shown = pcvae.decode(torch.zeros(3, 8), torch.tensor([0, 1, 3]))
    assert shown.shape == (3, 32, 32, 3)
    assert shown.min() >= 0 and shown.max() <= 1


@pytest.mark.parametrize(
    ("settings", "words"),
    [({"lr": 0.0}, "pcvae.lr"), ({"steps": 0}, "pcvae.steps"), ({"kl_ramp_start": 90.0}, "kl_ramp_end")],
)
def test_config_names_the_bad_key(settings, words):
    with pytest.raises(UserError, match=words):
        PcvaeConfig(**settings)
