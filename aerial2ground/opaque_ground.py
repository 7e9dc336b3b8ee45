"""Before any picture is looked at, the field learns that the ground is opaque.

What lies below the roads' height is made dense, what lies above keeps the thin fog that every field starts from. A
surface that is there from the first step need not condense from fog, which takes most of a short training.
"""

import math

import torch
from torch.nn import functional

from hashnerf.field import Field

STEPS, POINTS, RATE = 150, 1 << 14, 0.02
NEAR = 0.05
"""Metres above and below the ground in which half of the points lie."""
SHARE = 0.3
"""Of the greatest density that the field can have: opaque within a few cells, with room to grow."""


def make_ground_opaque(field: Field, height: float, seed: int) -> float:
    """Trains the densities alone; returns the last mean squared error of their logarithms."""
    above, below = field.log_initial_density, field.log_greatest_density + math.log(SHARE)
    low, high = field.box
    parameters = [field.hash_grid.table, *field.density_network.parameters()]
    optimizer = torch.optim.Adam(parameters, lr=RATE, betas=(0.9, 0.99), eps=1e-15, fused=True)
    generator = torch.Generator().manual_seed(seed)
    error = torch.zeros(())
    for step in range(STEPS):
        optimizer.param_groups[0]["lr"] = RATE * 0.1 ** (step / STEPS)
        points = low + (high - low) * torch.rand(POINTS, 3, generator=generator)
        points[::2, 2] = height + NEAR * (2 * torch.rand(len(points[::2]), generator=generator) - 1)
        wanted = torch.where(points[:, 2] < height, below, above)
        optimizer.zero_grad()
        density = field.density(points)[0]
        error = functional.mse_loss(density.clamp(min=1e-12).log(), wanted)
        error.backward()
        optimizer.step()
    return float(error.detach())
