"""The latent-conditioned field: standardised conditions, a bank that travels, the schedule of fresh latents."""

from dataclasses import replace

import pytest
import torch

from carff.latent_bank import build_bank
from carff.nerf import LatentNerf, NerfConfig
from hashnerf.cameras import Cameras
from hashnerf.errors import UserError
from hashnerf.field import FieldConfig
from hashnerf.occupancy import OccupancyConfig

SMALL = NerfConfig(
    field=FieldConfig(levels=2, log2_table_size=8, base_resolution=4, finest_resolution=8, hidden_width=8),
    occupancy=OccupancyConfig(cell=1.0),
)
BOX = torch.tensor([[-2.0, -2.0, 0.0], [2.0, 2.0, 2.0]])


def looking_down(width: int, height: int) -> Cameras:
    pose = torch.eye(4)[None].clone()
    pose[0, 2, 3] = 5.0
    focal, centre = torch.full((1, 2), float(width)), torch.tensor([[width / 2, height / 2]])
    return Cameras(pose, focal, centre, torch.zeros(1, 4), width, height)


def build() -> LatentNerf:
    torch.manual_seed(0)
    nerf = LatentNerf(SMALL, BOX, 2, 4)
    mean = torch.tensor([[0.0, 10.0], [2.0, 30.0], [4.0, 10.0], [6.0, 30.0]])
    state = torch.tensor([0, 0, 1, 1])
    nerf.set_bank(build_bank(mean, torch.full((4, 2), -20.0), state, torch.ones(4), torch.Generator()))
    return nerf


def test_conditions_are_standardised_by_the_bank():
    # Means 0 2 4 6 and 10 30 10 30: centres 3 and 20, standard deviations sqrt(5) and 10.
    condition = build().condition(torch.tensor([[3.0, 20.0], [3.0 + 5**0.5, 30.0]]))
    assert torch.allclose(condition, torch.tensor([[0.0, 0.0], [1.0, 1.0]]), atol=1e-3)


def test_the_bank_travels_with_the_weights():
    nerf, other = build(), LatentNerf(SMALL, BOX, 2, 4)
    other.load_state_dict(nerf.state_dict())
    for name in ("mean", "logvar", "state", "weight", "fixed"):
        assert torch.equal(getattr(other.bank, name), getattr(nerf.bank, name))


def test_density_is_one_row_per_latent():
    nerf = build()
    points = torch.rand(7, 3)
    density = nerf.density(points, torch.tensor([[0.0, 10.0], [6.0, 30.0], [0.0, 10.0]]))
    assert density.shape == (3, 7)
    assert torch.equal(density[0], density[2])


def test_a_pixel_is_the_mean_of_its_rays():
    nerf, cameras = build(), looking_down(4, 2)
    torch.nn.init.uniform_(nerf.field.hash_grid.table, -3, 3)
    latent = torch.tensor([0.0, 10.0])
    fine = nerf.picture(latent, cameras.scaled(8, 4), 0)
    by_hand = torch.stack([fine[0::2, 0::2], fine[1::2, 0::2], fine[0::2, 1::2], fine[1::2, 1::2]]).mean(dim=0)
    nerf.config = replace(SMALL, supersample=2)
    assert torch.allclose(nerf.picture(latent, cameras, 0), by_hand, atol=1e-6)
    assert by_hand.std() > 1e-3, "the picture must show something"


def test_fresh_share_by_hand():
    config = NerfConfig(steps=100, fresh_start=0.2, fresh_end=0.6)
    # 0.4 of the way lies half-way between 0.2 and 0.6.
    assert [round(config.fresh_share(step), 6) for step in (0, 20, 40, 60, 99)] == [0.0, 0.0, 0.5, 1.0, 1.0]
    assert NerfConfig(fresh_start=0.0, fresh_end=0.0).fresh_share(0) == 1.0


def test_bad_settings_are_named():
    with pytest.raises(UserError, match=r"nerf.fresh_end"):
        NerfConfig(fresh_start=0.5, fresh_end=0.2)
    with pytest.raises(UserError, match=r"nerf.changed_share"):
        NerfConfig(changed_share=1.5)


def test_a_guided_picture_asks_for_the_density_of_its_own_scene(monkeypatch):
    nerf, latent = build(), torch.tensor([6.0, 30.0])
    nerf.config = replace(SMALL, march=replace(SMALL.march, guided_per_opacity=4.0))
    asked, density = [], nerf.field.density

    def recorded(positions, condition=None, index=None):
        asked.append(condition[index.unique()])
        return density(positions, condition, index)

    monkeypatch.setattr(nerf.field, "density", recorded)
    nerf.picture(latent, looking_down(4, 2), 0)
    assert len(asked) == 1 and torch.equal(asked[0], nerf.condition(latent[None]))
