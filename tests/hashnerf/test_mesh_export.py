"""Meshes of analytic fields: right place, closed, coloured, and clear words when there is nothing."""

import pytest
import torch
import trimesh

from hashnerf.errors import UserError
from hashnerf.field import Field, FieldConfig
from hashnerf.mesh_export import extract_mesh, save_mesh

BOX = torch.tensor([[-2.0, -2.0, -1.0], [2.0, 2.0, 1.0]])


class Ball(Field):
    """A soft ball whose radius is the condition; red above, blue below."""

    def __init__(self):
        super().__init__(FieldConfig(levels=1, log2_table_size=4, base_resolution=2, finest_resolution=2), BOX, 1)

    def density_bank(self, positions, conditions=None):
        return torch.stack([40 * (row - positions.norm(dim=1)).clamp(min=0) for row in conditions])

    def forward(self, positions, directions, condition=None, condition_index=None):
        above = (positions[:, 2] > 0).float()
        assert torch.allclose(directions.norm(dim=1), torch.ones(len(directions)), atol=1e-4)
        assert ((directions * positions).sum(dim=1) < 0).all(), "the surface is looked at from outside"
        return above, torch.stack([above, torch.zeros_like(above), 1 - above], dim=1)


def test_a_ball_is_where_it_should_be():
    mesh = extract_mesh(Ball(), 0.1, torch.tensor([0.8]), level=1.0)
    # density 40 (0.8 - r) = 1 at r = 0.775
    radii = torch.tensor(mesh.vertices).norm(dim=1)
    assert (radii - 0.775).abs().max() < 0.03
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(4 / 3 * torch.pi * 0.775**3, rel=0.03)
    red = mesh.visual.vertex_colors[:, 0] == 255
    assert (red == (mesh.vertices[:, 2] > 0)).mean() > 0.99


def test_the_condition_chooses_the_scene():
    small, large = (extract_mesh(Ball(), 0.2, torch.tensor([radius]), level=1.0) for radius in (0.4, 0.9))
    assert small.volume < 0.2 * large.volume


def test_a_surface_that_meets_the_box_is_closed():
    mesh = extract_mesh(Ball(), 0.2, torch.tensor([1.5]), level=1.0)
    assert mesh.is_watertight
    assert mesh.bounds[1][2] == pytest.approx(1.0, abs=0.2)


def test_an_empty_field_is_a_clear_error():
    with pytest.raises(UserError, match="no surface"):
        extract_mesh(Ball(), 0.2, torch.tensor([0.0]), level=1.0)


@pytest.mark.parametrize("cell", [0.0, -1.0, float("nan"), 1e-4])
def test_impossible_cells_are_refused(cell):
    with pytest.raises(UserError, match="mesh cell"):
        extract_mesh(Ball(), cell, torch.tensor([0.5]))


@pytest.mark.parametrize("ending", ["ply", "glb"])
def test_files_can_be_read_back(tmp_path, ending):
    mesh = extract_mesh(Ball(), 0.2, torch.tensor([0.8]), level=1.0)
    path = tmp_path / "deep" / f"ball.{ending}"
    save_mesh(mesh, path)
    back = trimesh.load(path, force="mesh")
    assert len(back.faces) == len(mesh.faces)
    assert back.visual.vertex_colors.shape[1] == 4


def test_other_endings_are_refused(tmp_path):
    with pytest.raises(UserError, match=r"\.ply or \.glb"):
        save_mesh(trimesh.creation.box(), tmp_path / "mesh.xyz3")
