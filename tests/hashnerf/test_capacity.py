"""Capacity from pictures: measures by hand, and what follows from them."""

import math
from dataclasses import dataclass, replace
from dataclasses import field as option

import pytest
import torch

from hashnerf.capacity import (
    enlargement,
    filled_from,
    fitted_to_scene,
    is_open,
    measure_scene,
    structured_share,
    with_capacity,
)
from hashnerf.command_line import plain_config
from hashnerf.field import Field, FieldConfig
from hashnerf.marching import MarchSettings, intervals
from hashnerf.occupancy import OccupancyConfig, OccupancyGrid
from tests.hashnerf.posed_scene import posed_scene
from tests.hashnerf.test_visible_volume import downward


@dataclass(frozen=True)
class Settings:
    field: FieldConfig = option(default_factory=lambda: FieldConfig(levels=0, log2_table_size=0, finest_resolution=0))
    occupancy: OccupancyConfig = option(default_factory=lambda: OccupancyConfig(cell=0.0))
    march: MarchSettings = option(default_factory=lambda: MarchSettings(candidates=0, even_distance=0.0))


def noise(count: int, size: int) -> torch.Tensor:
    return torch.randint(0, 256, (count, size, size, 3), dtype=torch.uint8)


FLAT = torch.tensor([[-4.0, -4.0, -0.005], [4.0, 4.0, 0.005]])
FOUR = downward((0.0, 0.0), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
"""Four cameras 6 m above a thin box that fills 8 of the 12 m in their pictures; 20 pixels, focal length 10."""


def test_measures_by_hand():
    scene = measure_scene(noise(4, 20), FOUR, FLAT)
    assert scene.footprint == pytest.approx(0.6, rel=1e-2) and scene.distance == pytest.approx(6.0, rel=1e-2)
    # 4 pictures of 400 pixels that all show the same
    assert scene.texels == pytest.approx(400, rel=1e-2)
    assert scene.enlargement == 1
    # straight down a ray is 0.01 m in the box, at the corner sqrt(1 + 2 * (2/3)^2) times as long
    assert 0.01 < scene.chord < 0.01 * math.sqrt(1 + 8 / 9)


def test_more_pictures_of_the_same_place_need_no_more_entries_finer_ones_do():
    same = measure_scene(noise(8, 20), downward(*[(0.0, 0.0)] * 8), FLAT)
    assert same.texels == pytest.approx(400, rel=1e-2)
    finer = measure_scene(noise(4, 40), FOUR.scaled(40, 40), FLAT)
    assert finer.texels == pytest.approx(1600, rel=1e-2) and finer.footprint == pytest.approx(0.3, rel=1e-2)


def test_pixels_can_grow_until_the_pictures_suffer():
    plain = torch.full((1, 64, 64, 3), 90, dtype=torch.uint8)
    assert enlargement(plain) == 64
    ramp = torch.arange(64, dtype=torch.uint8).view(1, 1, 64, 1).expand(1, 64, 64, 3)
    assert 1 < enlargement(ramp) <= 64
    checks = ((torch.arange(64)[:, None] // 4 + torch.arange(64) // 4) % 2 * 200).to(torch.uint8)
    assert enlargement(checks[None, :, :, None].expand(1, 64, 64, 3)) == 1
    assert enlargement(noise(1, 64)) == 1


def test_a_small_thing_keeps_its_detail():
    picture = torch.full((1, 128, 128, 3), 90, dtype=torch.uint8)
    picture[0, 40:52, 40:52] = noise(1, 12)[0]
    # over the whole picture pixels of twice the size would lose little
    assert enlargement(picture) == 1


def test_a_thin_box_has_not_more_occupancy_cells_than_others():
    wide = torch.tensor([[-500.0, -500.0, 0.0], [500.0, 500.0, 0.01]])
    far = downward(*[(0.0, 0.0)] * 4)
    full, _ = fitted_to_scene(Settings(), noise(4, 20), far, wide)
    assert math.prod(OccupancyGrid(full.occupancy, wide).shape) <= 2**19


def test_pictures_smaller_than_any_enlargement():
    assert enlargement(torch.full((1, 1, 3, 3), 7, dtype=torch.uint8)) == 1


def test_blocks_of_one_colour_show_nothing():
    pictures = torch.full((1, 16, 16, 3), 90, dtype=torch.uint8)
    pictures[0, :8, :8] = noise(1, 8)[0]
    assert structured_share(pictures) == pytest.approx(0.25)
    pictures[0, 8:, 8:] += torch.randint(0, 2, (8, 8, 3), dtype=torch.uint8)  # the last bit
    assert structured_share(pictures) == pytest.approx(0.25)


def test_the_finest_cell_is_a_pixels_footprint_and_levels_grow_by_half():
    full, reason = fitted_to_scene(Settings(), noise(4, 20), FOUR, FLAT)
    assert full.field.finest_resolution == pytest.approx(8 / 0.6, abs=1)
    assert full.field.base_resolution == full.field.finest_resolution and full.field.levels == 1
    finer, _ = fitted_to_scene(Settings(), noise(4, 200), FOUR.scaled(200, 200), FLAT)
    # 16 cells times 1.5 a level: 133 cells after 5.2 levels
    assert finer.field.finest_resolution == pytest.approx(133, abs=2) and finer.field.levels == 7
    # 2 vertices for each of 40,000 texels
    assert finer.field.log2_table_size == 17
    assert "7 levels" in (line := fitted_to_scene(Settings(), noise(4, 200), FOUR.scaled(200, 200), FLAT)[1])
    assert "2^17" in line and "\n" not in line + reason
    assert not is_open(full) and is_open(Settings())


def test_stated_values_stay():
    stated = Settings(field=FieldConfig(levels=3, log2_table_size=0, finest_resolution=100))
    full, _ = fitted_to_scene(stated, noise(4, 20), FOUR, FLAT)
    assert (full.field.levels, full.field.finest_resolution, full.field.base_resolution) == (3, 100, 16)
    assert full.field.log2_table_size > 0 and full.march.even_distance == pytest.approx(6.0, rel=1e-2)
    whole = Settings(FieldConfig(), OccupancyConfig(), MarchSettings())
    assert fitted_to_scene(whole, noise(4, 20), FOUR, FLAT)[0] == whole and not is_open(whole)


def test_an_empty_scene_gets_next_to_nothing():
    plain = torch.full((4, 128, 128, 3), 90, dtype=torch.uint8)
    full, reason = fitted_to_scene(Settings(), plain, FOUR.scaled(128, 128), FLAT)
    assert (full.field.levels, full.field.log2_table_size, full.field.finest_resolution) == (1, 8, 2)
    assert "taken for empty" in reason and not is_open(full)
    # so clear that no cell of the occupancy grid is ever sampled
    field, grid = Field(full.field, FLAT), OccupancyGrid(full.occupancy, FLAT)
    for _ in range(full.occupancy.warmup):
        grid.update(lambda places: field.density(places)[0][None])
    assert grid.is_empty()


def test_what_an_empty_scene_is_told_stays():
    stated = Settings(field=FieldConfig(levels=3, log2_table_size=0, finest_resolution=100))
    full, _ = fitted_to_scene(stated, torch.full((4, 16, 16, 3), 9, dtype=torch.uint8), FOUR.scaled(16, 16), FLAT)
    assert (full.field.levels, full.field.finest_resolution, full.field.base_resolution) == (3, 100, 16)


def test_a_trained_fields_settings_come_back_from_its_config():
    data = posed_scene()
    full, _ = fitted_to_scene(Settings(), data.images, data.cameras, data.scene_box)
    again = filled_from(Settings(), plain_config(full))
    assert again == full
    stated = Settings(field=FieldConfig(levels=0, log2_table_size=12, finest_resolution=0))
    assert filled_from(stated, plain_config(full)).field == replace(full.field, log2_table_size=12)


def test_an_empty_scene_whose_field_was_stated_is_continued_in_clear_air():
    stated = Settings(field=FieldConfig(levels=3, log2_table_size=9, finest_resolution=100))
    full, _ = fitted_to_scene(stated, torch.full((4, 128, 128, 3), 90, dtype=torch.uint8), FOUR.scaled(128, 128), FLAT)
    assert full.field.initial_thickness < stated.field.initial_thickness
    assert filled_from(stated, plain_config(full)) == full


def test_what_was_stored_is_taken_and_nothing_is_derived_anew(capsys):
    data = posed_scene()
    pictures = (data.images, data.cameras, data.scene_box)
    first = with_capacity(Settings(), None, *pictures)
    assert "capacity: pixels cover" in capsys.readouterr().err
    stored = plain_config(replace(first, field=replace(first.field, levels=2, initial_thickness=0.5)))
    again = with_capacity(Settings(), stored, *pictures)
    assert (again.field.levels, again.field.initial_thickness) == (2, 0.5)
    assert with_capacity(first, stored, *pictures) is first and not capsys.readouterr().err


@pytest.mark.parametrize("name", ["levels", "log2_table_size", "finest_resolution"])
def test_what_is_left_open_cannot_be_built(name):
    with pytest.raises(ValueError, match="fitted_to_scene"):
        Field(FieldConfig(**{name: 0}), FLAT)


def test_open_cells_and_samples_are_refused():
    with pytest.raises(ValueError, match="fitted_to_scene"):
        OccupancyGrid(OccupancyConfig(cell=0.0), FLAT)
    for settings in (MarchSettings(candidates=0), MarchSettings(even_distance=0.0)):
        with pytest.raises(ValueError, match="fitted_to_scene"):
            intervals(torch.zeros(1), torch.ones(1), settings)


def test_cameras_that_see_nothing_of_the_box():
    away = FLAT + torch.tensor([100.0, 0.0, 0.0])
    scene = measure_scene(noise(4, 20), FOUR, away)
    assert math.isfinite(scene.footprint) and scene.distance == pytest.approx(math.hypot(100, 6), rel=1e-3)
    assert scene.texels > 1 and scene.chord > 0
