"""An opaque ground before the first picture."""

import torch

from aerial2ground.opaque_ground import make_ground_opaque
from hashnerf.field import Field, FieldConfig

BOX = torch.tensor([[-1.0, -1.0, -0.1], [3.0, 2.0, 0.7]])


def test_below_the_ground_is_opaque_and_above_it_is_fog():
    torch.manual_seed(0)
    config = FieldConfig(levels=6, log2_table_size=14, finest_resolution=128, flatness=2.0, initial_thickness=8.0)
    field = Field(config, BOX)
    places = torch.rand(400, 3) * torch.tensor([4.0, 3.0, 0.0]) + torch.tensor([-1.0, -1.0, 0.0])
    before = float(field.density(places + torch.tensor([0.0, 0.0, 0.3]))[0].mean())
    error = make_ground_opaque(field, 0.05, 0)
    below, above = (field.density(places + torch.tensor([0.0, 0.0, z]))[0].detach() for z in (0.02, 0.15))
    # 8 over the longest side of 4 m: 2 per metre, as every field starts; the ground has 4 * 128 * 2 / 4 * 0.3 = 77
    assert abs(before - 2.0) < 0.1 and float(above.median()) < 5.0
    assert 40 < float(below.median()) < 130 and error < 1.0
