"""The numbered row of loading posed images: map coordinates must not cost a picture its detail."""

import json

import numpy as np
import torch

from hashnerf.cameras import look_at
from hashnerf.field import Field, FieldConfig
from hashnerf.image_files import write_png
from hashnerf.marching import MarchSettings
from hashnerf.occupancy import OccupancyConfig, OccupancyGrid
from hashnerf.posed_images import load_posed_images
from hashnerf.render import render_images

SIZE = 24
BOX = np.array([[-3.0, -3.0, -1.0], [3.0, 3.0, 2.0]])


def pictures_at(folder, shift):
    """What every camera sees of one random field, the whole data set moved by a shift (m)."""
    frames = []
    for camera, place in enumerate([(5.13, 1.21, 2.07), (-2.29, 4.17, 1.58), (0.71, -5.33, 3.14)]):
        name = f"images/{camera}.png"
        write_png(folder / name, np.full((SIZE, SIZE, 3), 40 * camera, np.uint8))
        pose = look_at(place, (0, 0, 0.5)).double().numpy()
        pose[:3, 3] += shift
        frames.append({"file_path": name, "transform_matrix": pose.tolist(), "camera": camera})
    lens = {"w": SIZE, "h": SIZE, "fl_x": 30.0, "fl_y": 30.0, "cx": SIZE / 2, "cy": SIZE / 2}
    document = {"camera_model": "OPENCV", **lens, "scene_box": (BOX + shift).tolist(), "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(document))
    posed = load_posed_images(folder)
    torch.manual_seed(0)
    field = Field(FieldConfig(levels=4, log2_table_size=12, base_resolution=4, finest_resolution=32), posed.scene_box)
    torch.nn.init.uniform_(field.hash_grid.table, -1, 1)
    everywhere = OccupancyGrid(OccupancyConfig(cell=0.5, warmup=100), posed.scene_box)
    settings = MarchSettings(candidates=64, samples=0)
    return torch.stack(
        [
            render_images(posed.cameras, [row], lambda x, d, ray: field(x, d), everywhere, settings).rgb
            for row in range(len(posed))
        ]
    )


def test_n10_map_coordinates_render_like_small_ones(tmp_path, numeric_row):
    (tmp_path / "near").mkdir()
    near = pictures_at(tmp_path / "near", np.zeros(3))
    assert near.std() > 0.02, "the pictures must show something"
    for shift in ([500_000.0, 4_649_776.0, 35.0], [990.3, -980.7, 35.0]):
        folder = tmp_path / f"far{shift[0]:.0f}"
        folder.mkdir()
        mse = (pictures_at(folder, np.array(shift)) - near).square().mean().item()
        # the second shift is small enough to stay; a PSNR of 60 dB is a mean square of 1e-6
        numeric_row("N10", f"three pictures, cameras moved by {shift}: mean square error", mse, 1e-6)
