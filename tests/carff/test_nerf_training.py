"""Stage 2 on a tiny data set: the bank, the held-out camera, and that latents switch what is rendered."""

import torch

from carff.nerf import LatentNerf, NerfConfig
from carff.nerf_training import build_nerf, train_nerf, training_views
from carff.transitions import ViewBeliefs
from hashnerf.field import FieldConfig
from hashnerf.fit import FitConfig
from hashnerf.marching import MarchSettings
from hashnerf.model_files import load_model
from hashnerf.occupancy import OccupancyConfig

CONFIG = NerfConfig(
    field=FieldConfig(levels=4, log2_table_size=12, base_resolution=4, finest_resolution=32, hidden_width=32),
    occupancy=OccupancyConfig(cell=1.0),
    march=MarchSettings(candidates=32),
    fit=FitConfig(rays=512, batch_samples=8192),
    steps=150,
    latents_per_step=4,
)


def beliefs() -> ViewBeliefs:
    """States at the corners of a square in latent space; camera 0 cannot tell the branches apart."""
    means = torch.zeros(4, 4, 2)
    for state in range(4):
        means[state, 1:] = torch.tensor([float(state // 2), float(state % 2)]) * 2 - 1
        means[state, 0] = torch.tensor([0.0, float(state % 2) * 2 - 1])
    return ViewBeliefs(means, torch.full((4, 4, 2), -6.0), torch.ones(4, 4, dtype=torch.bool))


def test_a_view_that_cannot_tell_has_no_weight(tiny_data):
    nerf = build_nerf(CONFIG, beliefs(), tiny_data.scene_box, seed=0)
    weight = nerf.bank.weight.reshape(4, 4)
    assert torch.allclose(weight[:, 0], torch.zeros(4), atol=1e-6)
    assert torch.allclose(weight.sum(dim=1), torch.ones(4))


def test_the_held_out_kind_is_left_out(tiny_table):
    assert (training_views(tiny_table, ("birds_eye",))[:, 3] == -1).all()
    assert (training_views(tiny_table) >= 0).all()


def test_latents_switch_the_scene(tiny_data, tiny_table, tmp_path):
    nerf = build_nerf(CONFIG, beliefs(), tiny_data.scene_box, seed=0)
    train_nerf(CONFIG, nerf, tiny_data, training_views(tiny_table), tmp_path / "run", {}, CONFIG.steps)
    trained, _ = load_model(tmp_path / "run", lambda _: LatentNerf(CONFIG, tiny_data.scene_box, 2, 16), "x")
    truth = tiny_data.images.reshape(4, 4, 32, 32, 3).float() / 255
    shown = [trained.picture(trained.bank.state_beliefs().mean[s], tiny_data.cameras, 1) for s in range(4)]
    errors = torch.tensor([[(shown[s] - truth[other, 1]).square().mean() for other in range(4)] for s in range(4)])
    assert torch.equal(errors.argmin(dim=1), torch.arange(4))
