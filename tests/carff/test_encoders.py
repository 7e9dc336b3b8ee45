"""Encoders: one picture alone equals the same picture in a batch; ViT features are frozen, normalised and cached."""

import pytest
import torch

from carff import encoders
from carff.encoders import EncoderConfig, build_encoder, load_vit
from hashnerf.errors import UserError


def pictures(count: int, size: int = 32):
    return torch.randint(256, (count, size, size, 3), generator=torch.Generator().manual_seed(0), dtype=torch.uint8)


@pytest.fixture(scope="module")
def vit_folder(tmp_path_factory):
    """A tiny, randomly initialised Vision Transformer saved as a local folder."""
    import transformers

    torch.manual_seed(0)
    config = transformers.ViTConfig(
        hidden_size=16, num_hidden_layers=2, num_attention_heads=2, intermediate_size=32, image_size=32, patch_size=8
    )
    folder = tmp_path_factory.mktemp("vit")
    transformers.ViTModel(config, add_pooling_layer=False).save_pretrained(folder)
    return str(folder)


def test_conv_belief_does_not_depend_on_the_batch():
    torch.manual_seed(0)
    encoder = build_encoder(EncoderConfig(width=8), 4, 32, 32).eval()
    batch = encoder(pictures(6))
    alone = torch.cat([encoder(picture[None]) for picture in pictures(6)])
    assert batch.shape == (6, 8)
    # The convolutions run in bfloat16, whose last bit is 2^-8; their sums may be ordered differently by batch size.
    assert torch.allclose(batch, alone, atol=2e-2)


def test_half_precision_layers_follow_their_weights_whatever_autocast_is_around(monkeypatch):
    monkeypatch.setattr(encoders, "multiplies_bfloat16", lambda device_type: True)
    torch.manual_seed(0)
    encoder = build_encoder(EncoderConfig(width=8), 4, 32, 32).eval()
    first = encoder.trunk[0]
    with torch.autocast("cpu", enabled=False):  # lasts for a whole training
        before = encoder(pictures(1))
        with torch.no_grad():
            first.weight.neg_()
            first.bias.neg_()
        assert not torch.equal(encoder(pictures(1)), before)


def test_jitter_only_with_a_generator():
    torch.manual_seed(0)
    encoder = build_encoder(EncoderConfig(width=8), 4, 32, 32)
    plain = encoder(pictures(2))
    jittered = encoder(pictures(2), torch.Generator().manual_seed(0))
    assert torch.equal(plain, encoder(pictures(2)))
    assert not torch.equal(plain, jittered)


def test_vit_features_are_the_same_alone_and_frozen(vit_folder):
    encoder = build_encoder(EncoderConfig(kind="vit", vit_model=vit_folder), 4, 128, 128)
    features = encoder.prepare(pictures(5, 48), batch=2)
    alone = torch.cat([encoder.prepare(picture[None]) for picture in pictures(5, 48)])
    assert features.shape == (5, 32)
    assert torch.allclose(features, alone, atol=2e-2)
    assert not features.requires_grad
    # Only the head trains: LayerNorm 2 x 32, Linear 32 x 256 + 256, Linear 256 x 8 + 8.
    assert sum(p.numel() for p in encoder.parameters()) == 64 + 32 * 256 + 256 + 256 * 8 + 8


def test_vit_input_is_normalised_with_the_imagenet_statistics(vit_folder):
    encoder = build_encoder(EncoderConfig(kind="vit", vit_model=vit_folder), 4, 32, 32)
    seen = []
    encoder.backbone[0].register_forward_pre_hook(
        lambda module, args, kwargs: seen.append(kwargs["pixel_values"]), with_kwargs=True
    )
    encoder.prepare(torch.full((1, 32, 32, 3), 255, dtype=torch.uint8))
    # White: (1 - 0.485) / 0.229 = 2.2489 in red.
    assert torch.allclose(seen[0][0, 0], torch.full((32, 32), 2.2489), atol=1e-3)


def test_a_missing_model_is_a_sentence(tmp_path):
    with pytest.raises(UserError, match="cannot be loaded"):
        load_vit(str(tmp_path / "nothing"))


def test_sizes_the_convolutions_cannot_halve_are_refused():
    with pytest.raises(UserError, match="multiples of 32, not 100 x 96"):
        build_encoder(EncoderConfig(), 8, 96, 100)


def test_pictures_need_not_be_square():
    encoder = build_encoder(EncoderConfig(width=8), 4, 32, 64)
    pictures = torch.zeros(2, 32, 64, 3, dtype=torch.uint8)
    assert encoder(encoder.prepare(pictures), torch.Generator().manual_seed(0)).shape == (2, 8)
