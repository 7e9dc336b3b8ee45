"""Stage 1 learns the states that pictures show, and takes the same path after an interruption."""

import json

import pytest
import torch

from carff.beliefs import reparameterise
from carff.encoders import EncoderConfig
from carff.pcvae import Pcvae, PcvaeConfig
from carff.pcvae_training import even_psnr_db, rate_factor, train_pcvae
from carff.view_priority import ViewPriority
from hashnerf.model_files import load_model


def config(steps: int) -> PcvaeConfig:
    return PcvaeConfig(steps=steps, batch_size=16, save_every=10, lr=0.003, encoder=EncoderConfig(width=8, augment=0.2))


def build(tiny_data, tiny_table, steps: int) -> Pcvae:
    torch.manual_seed(0)
    return Pcvae(config(steps), tiny_table.camera_poses, tiny_data.scene_box, len(tiny_table), 32, 32)


def train(tiny_data, tiny_table, folder, steps: int) -> Pcvae:
    pcvae = build(tiny_data, tiny_table, steps)
    train_pcvae(config(steps), pcvae, tiny_data, tiny_table, folder, {"steps": 40}, seed=3)
    return pcvae


def test_latents_separate_what_the_pictures_separate(tiny_data, tiny_table, tmp_path):
    pcvae = train(tiny_data, tiny_table, tmp_path / "run", 150)
    belief = pcvae.encode(tiny_data.images)
    mean, spread = belief.mean.reshape(2, 2, 4, 8), (0.5 * belief.logvar).exp().mean()
    hidden = (mean[0, :, 0] - mean[1, :, 0]).norm(dim=-1)
    seen = (mean[0, :, 1:3] - mean[1, :, 1:3]).norm(dim=-1)
    # Camera 0 sees equal pictures in both branches; the others see the square.
    assert hidden.max() < 1e-4
    assert seen.min() > 3 * spread


def test_saved_model_is_the_trained_one(tiny_data, tiny_table, tmp_path):
    pcvae = train(tiny_data, tiny_table, tmp_path / "run", 20)
    loaded, cost = load_model(tmp_path / "run", lambda _: build(tiny_data, tiny_table, 20), "train_pcvae.py")
    assert torch.equal(loaded.encode(tiny_data.images).mean, pcvae.encode(tiny_data.images).mean)
    assert cost["seconds"] > 0


def test_the_logged_psnr_is_that_of_the_decoded_pictures(tiny_data, tiny_table, tmp_path):
    pcvae = train(tiny_data, tiny_table, tmp_path / "run", 60)
    states, cameras = (tiny_table.views >= 0).nonzero(as_tuple=True)
    frames = tiny_table.views[states, cameras]
    logged = even_psnr_db(pcvae, tiny_data.images[frames], states, 0, count=500)
    assert not pcvae.training
    belief = pcvae.encode(tiny_data.images[frames])
    latents = reparameterise(belief, torch.Generator().manual_seed(1))
    squared = []
    for camera in range(4):
        shown = pcvae.decode(latents, torch.full((len(frames),), camera))
        truth = tiny_data.images[tiny_table.views[states, camera]].float() / 255
        squared.append((shown - truth).square().mean())
    expected = -10 * torch.log10(torch.stack(squared).mean())
    assert abs(logged - expected) < 0.5, "the same but for which views were drawn, and pictures clamped to [0, 1]"


def test_k06_an_interrupted_training_takes_the_same_path(tiny_data, tiny_table, tmp_path, monkeypatch, numeric_row):
    whole = train(tiny_data, tiny_table, tmp_path / "whole", 90)
    record = ViewPriority.record
    calls = []

    def interrupted(self, rows, errors):
        calls.append(1)
        if len(calls) == 75:  # after the views' errors have begun to count
            raise KeyboardInterrupt
        record(self, rows, errors)

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(ViewPriority, "record", interrupted)
        train(tiny_data, tiny_table, tmp_path / "run", 90)
    resumed = train(tiny_data, tiny_table, tmp_path / "run", 90)
    different = sum(not torch.equal(a, b) for a, b in zip(whole.state_dict().values(), resumed.state_dict().values()))
    lines = [(tmp_path / name / "metrics.jsonl").read_text().splitlines() for name in ("whole", "run")]
    logged = [[{**json.loads(line), "seconds": 0, "processor_seconds": 0} for line in part] for part in lines]
    different += sum(a != b for a, b in zip(*logged, strict=True))
    assert len({line["kl_weight"] for line in logged[0]}) > 1
    numeric_row("K06", "PC-VAE, 90 steps, stopped at 75: tensors, losses or KL weights that differ", different)


def test_k43_fewer_views_than_a_batch_are_enough(tiny_data, tiny_table, tmp_path, numeric_row):
    few = PcvaeConfig(steps=3, batch_size=64, encoder=EncoderConfig(width=8))
    pcvae = build(tiny_data, tiny_table, 3)
    train_pcvae(few, pcvae, tiny_data, tiny_table, tmp_path / "run", {}, seed=3)
    bad = sum(not bool(value.isfinite().all()) for value in pcvae.state_dict().values())
    numeric_row("K43", "16 views, batches of 64: tensors not finite", bad)


def test_rate_warms_up_and_ends_at_zero():
    assert rate_factor(0, 1000) == 1 / 50
    assert rate_factor(500, 1000) == 0.5
    assert rate_factor(1000, 1000) < 1e-12
