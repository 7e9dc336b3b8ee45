"""A triangle mesh of a radiance field under one condition: where density crosses a level (marching cubes)."""

import math
from pathlib import Path

import numpy as np
import torch
import trimesh
from jaxtyping import Float
from skimage.measure import marching_cubes
from torch import Tensor

from hashnerf.errors import UserError
from hashnerf.field import Field

FORMATS = (".ply", ".glb")
MOST_POINTS = 1 << 27
CHUNK = 1 << 16  # points evaluated at once


@torch.no_grad()
def extract_mesh(
    field: Field, cell: float, condition: Float[Tensor, " c"] | None = None, level: float | None = None
) -> trimesh.Trimesh:
    """Triangulate the field on a lattice of `cell` metres; vertex colours are seen head-on; closed at the box.

    `level` is a density (1/m); by default half of the light is stopped within one cell. Raises UserError if nothing is
    that dense, or if the lattice would be too large.
    """
    if not 0 < cell < math.inf:
        raise UserError(f"mesh cell is {cell}: use a positive number of metres")
    level = math.log(2) / cell if level is None else level
    low, high = field.box.cpu().double()
    counts = [max(2, math.ceil(side / cell) + 1) for side in (high - low).tolist()]
    if math.prod(counts) > MOST_POINTS:
        raise UserError(f"mesh cell is {cell} m: the lattice would have {math.prod(counts):,} points; use larger cells")
    spacing = ((high - low) / (torch.tensor(counts) - 1)).tolist()
    volume = _sample_density(field, low, spacing, counts, condition)
    if not volume.max() > level:
        raise UserError(
            f"the field has no surface: its density reaches {volume.max():.3g}/m, below the level {level:.3g}/m; "
            "train longer or lower the level"
        )
    # a border of zeros closes the surface where it meets the box; marching cubes counts from it
    vertices, faces, normals, _ = marching_cubes(
        np.pad(volume, 1), level, spacing=tuple(spacing), gradient_direction="ascent"
    )
    vertices = (vertices - np.array(spacing)) + low.numpy()
    colours = _colours(field, vertices, normals, condition)
    return trimesh.Trimesh(vertices, faces, vertex_colors=colours, process=False)


def save_mesh(mesh: trimesh.Trimesh, path: Path) -> None:
    """Write a mesh as .ply or .glb; raises UserError for another suffix."""
    if path.suffix.lower() not in FORMATS:
        raise UserError(f"{path}: a mesh is written as {' or '.join(FORMATS)}; choose one of these endings")
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh.export(path)


def _sample_density(
    field: Field, low: Tensor, spacing: list[float], counts: list[int], condition: Tensor | None
) -> np.ndarray:
    axes = [float(low[axis]) + spacing[axis] * torch.arange(counts[axis]).double() for axis in range(3)]
    points = torch.cartesian_prod(*axes).float().to(field.box.device)
    # rounding must not push the last lattice plane out of the box, where the field has no features
    points = torch.minimum(torch.maximum(points, field.box[0]), field.box[1])
    bank = None if condition is None else condition[None]
    parts = [field.density_bank(chunk, bank)[0].cpu() for chunk in points.split(CHUNK)]
    return torch.cat(parts).view(*counts).numpy()


def _colours(field: Field, vertices: np.ndarray, normals: np.ndarray, condition: Tensor | None) -> np.ndarray:
    points = torch.from_numpy(np.ascontiguousarray(vertices)).float().to(field.box.device)
    points = torch.minimum(torch.maximum(points, field.box[0]), field.box[1])
    towards = torch.from_numpy(-np.ascontiguousarray(normals)).float().to(points.device)
    length = towards.norm(dim=1, keepdim=True)
    # a degenerate triangle has no normal: look at it from above
    down = towards.new_tensor([0.0, 0.0, -1.0]).expand_as(towards)
    towards = torch.where(length > 1e-6, towards / length.clamp(min=1e-6), down)
    rows = None if condition is None else condition[None]
    parts = []
    for position, direction in zip(points.split(CHUNK), towards.split(CHUNK)):
        index = None if rows is None else torch.zeros(len(position), dtype=torch.int64, device=position.device)
        parts.append(field(position, direction, rows, index)[1].cpu())
    return (torch.cat(parts) * 255).round().to(torch.uint8).numpy()
