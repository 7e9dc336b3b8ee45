"""The radiance field: hash grid -> density network -> colour network, both optionally conditioned.

density(x, c) = exp(bounded(raw(x, c))), 1/m; rgb(x, d, c) in [0, 1]; x world metres, d unit direction, c a condition
vector such as a scene latent. c enters both networks after the hash grid, which all conditions share (CARFF B.3).
Conditions are given per sample ([s, c]), or as rows ([g, c]) with the row of every sample ([s]).

The density is softly bounded by what makes a cell of the finest level opaque (`cell_thickness`). Beyond that no picture
changes, but training goes on raising it: the logarithm is interpolated between the grid's vertices, so a surface of a
thousand per metre leaves fog where there should be air, and the samples of a ray jump from nothing to opaque.
"""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from hashnerf.activations import at_least_float32, truncated_exp
from hashnerf.background import Background
from hashnerf.errors import UserError
from hashnerf.hash_grid import HashGrid
from hashnerf.mlp import MLP
from hashnerf.rays import Rays
from hashnerf.spherical_harmonics import MAX_DEGREE, spherical_harmonics

LEAK = 0.01


@dataclass(frozen=True)
class FieldConfig:
    """Capacity of a radiance field."""

    levels: int = 8
    """Resolutions of the hash grid; 0 derives them from the scene (`hashnerf.capacity`)."""
    features_per_level: int = 2
    """Features stored per vertex (even)."""
    log2_table_size: int = 17
    """Each level stores at most 2 to this power vertices; vertices beyond share entries. 0 derives it."""
    base_resolution: int = 16
    """Cells along the longest side of the scene box at the coarsest level."""
    finest_resolution: int = 192
    """Cells along the longest side of the scene box at the finest level; cells much finer than a pixel's footprint only
    add speckle. 0 derives it from the scene."""
    flatness: float = 1.0
    """Cells are this many times lower than wide: seen at a grazing angle, flat ground must be thin."""
    hidden_width: int = 64
    """Units of every hidden layer."""
    density_layers: int = 1
    """Hidden layers of the density network."""
    colour_layers: int = 2
    """Hidden layers of the colour network."""
    geometry_features: int = 15
    """Numbers the density network hands to the colour network."""
    direction_degree: int = 3
    """Bands of spherical harmonics of the viewing direction, 1 (none of it matters) to 4."""
    ground: bool = False
    """Beyond the box a flat ground goes on at the height of its floor, coloured by place; else what lies beyond is
    coloured by direction alone."""
    sky_width: int = 0
    """Units of a hidden layer between the direction and the sky's colour, which can show a sharp horizon; 0: none."""
    initial_thickness: float = 3.0
    """Optical thickness of the box along its longest side before training."""
    cell_thickness: float = 4.0
    """About the greatest optical thickness of a cell of the finest level along z (4 leaves 2 % of the light): beyond it
    the logarithm of the density grows at a hundredth of the rate."""
    mlp_dtype: Literal["float32", "bfloat16"] = "float32"
    """Arithmetic of the networks; everything else stays float32. bfloat16 counts only where the device multiplies it in
    hardware: emulated it is twenty times slower than float32."""
    compile: bool = False
    """Compile the hash grid with torch.compile where a compiler works."""

    def __post_init__(self):
        whole = ("features_per_level", "base_resolution", "hidden_width", "density_layers", "colour_layers")
        for name in whole:
            if getattr(self, name) < 1:
                raise UserError(f"field.{name} is {getattr(self, name)}: use at least 1")
        if self.levels < 0:
            raise UserError(f"field.levels is {self.levels}: use at least 1, or 0 to derive them from the scene")
        if self.features_per_level % 2:
            raise UserError(f"field.features_per_level is {self.features_per_level}: use an even number")
        if self.log2_table_size and not 4 <= self.log2_table_size <= 28:
            raise UserError(f"field.log2_table_size is {self.log2_table_size}: use 4 to 28, or 0 to derive it")
        if self.finest_resolution and self.finest_resolution < self.base_resolution:
            raise UserError(
                f"field.finest_resolution is {self.finest_resolution}: use at least base_resolution, "
                f"{self.base_resolution}"
            )
        if not 1 <= self.direction_degree <= MAX_DEGREE:
            raise UserError(f"field.direction_degree is {self.direction_degree}: use 1 to {MAX_DEGREE}")
        for name in ("geometry_features", "sky_width"):
            if getattr(self, name) < 0:
                raise UserError(f"field.{name} is {getattr(self, name)}: use 0 or more")
        for name in ("flatness", "initial_thickness", "cell_thickness"):
            if not 0 < getattr(self, name) < math.inf:
                raise UserError(f"field.{name} is {getattr(self, name)}: use a positive number")
        if self.finest_resolution and self.initial_thickness >= self.greatest_thickness:
            raise UserError(
                f"field.initial_thickness is {self.initial_thickness}: use less than "
                f"{self.greatest_thickness:g}, cell_thickness times finest_resolution times flatness"
            )

    @property
    def greatest_thickness(self) -> float:
        """Optical thickness of the box along its longest side where it is as dense as can be."""
        return self.cell_thickness * self.finest_resolution * self.flatness


class Field(nn.Module):
    """A conditioned radiance field over a box (metres)."""

    def __init__(self, config: FieldConfig, scene_box: Float[Tensor, "2 3"], condition_size: int = 0):
        super().__init__()
        if not (config.levels and config.log2_table_size and config.finest_resolution):
            raise ValueError("the field's levels, log2_table_size or finest_resolution is 0: use fitted_to_scene first")
        self.config, self.condition_size = config, condition_size
        self.hash_grid = HashGrid(
            scene_box.float(),
            config.levels,
            config.features_per_level,
            config.log2_table_size,
            config.base_resolution,
            config.finest_resolution,
            config.compile,
            config.flatness,
        )
        # weights of the table start near zero, so this bias alone sets the density everywhere
        longest = float((scene_box[1] - scene_box[0]).amax())
        greatest = config.greatest_thickness
        self.log_greatest_density = math.log(greatest / longest)
        # log1p makes up for what the bound takes from it
        share = config.initial_thickness / greatest
        self.log_initial_density = math.log(config.initial_thickness) - math.log(longest) - math.log1p(-share)
        low = config.mlp_dtype == "bfloat16"
        harmonics, geometry = config.direction_degree**2, config.geometry_features
        encoded = self.hash_grid.out_features
        self.density_network = MLP(
            encoded + condition_size, config.hidden_width, config.density_layers, 1 + geometry, low
        )
        self.colour_network = MLP(
            harmonics + geometry + condition_size, config.hidden_width, config.colour_layers, 3, low
        )
        self.beyond = Background(
            scene_box.float(), config.direction_degree, condition_size, config.ground, config.sky_width
        )

    @property
    def box(self) -> Float[Tensor, "2 3"]:
        """The region the field models, metres."""
        return self.hash_grid.box

    def harmonics(self, directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n harmonics"]:
        """Encode unit directions as `forward` wants them."""
        return spherical_harmonics(directions, self.config.direction_degree)

    def density(
        self,
        positions: Float[Tensor, "s 3"],
        condition: Float[Tensor, "g c"] | None = None,
        condition_index: Int[Tensor, " s"] | None = None,
    ) -> tuple[Float[Tensor, " s"], Float[Tensor, "s geometry"]]:
        """Return density (1/m) and the geometry features that the colour network reads."""
        return self._density(positions, self._columns(condition, condition_index))

    def _density(self, positions: Tensor, condition: list[Tensor]) -> tuple[Tensor, Tensor]:
        out = self.density_network([self.hash_grid(positions), *condition])
        return self._bounded_density(out[:, 0]), out[:, 1:]

    def _bounded_density(self, raw: Tensor) -> Tensor:
        log_density = at_least_float32(raw) + self.log_initial_density
        # the leak keeps a slope however far beyond the bound a value has strayed, so that it can come back
        over = nn.functional.softplus(log_density - self.log_greatest_density)
        return truncated_exp(log_density - (1 - LEAK) * over)

    def _columns(self, condition: Tensor | None, index: Tensor | None) -> list[Tensor]:
        """The condition of each sample as a list of input columns: one tensor or none."""
        self._check(condition)
        if condition is None or index is None:
            return [] if condition is None else [condition]
        return [condition.index_select(0, index)]

    def _check(self, condition: Tensor | None) -> None:
        size = 0 if condition is None else condition.shape[1]
        if size != self.condition_size:
            raise ValueError(f"the field takes conditions of length {self.condition_size}, not {size}")

    def density_bank(
        self, positions: Float[Tensor, "p 3"], conditions: Float[Tensor, "bank c"] | None = None
    ) -> Float[Tensor, "bank_or_one p"]:
        """Return the density (1/m) at each position under each condition of a bank; positions are encoded once."""
        self._check(conditions)
        out = self.density_network.first_output_bank(self.hash_grid(positions), conditions)
        return self._bounded_density(out)

    def forward(
        self,
        positions: Float[Tensor, "s 3"],
        directions: Float[Tensor, "s 3"],
        condition: Float[Tensor, "g c"] | None = None,
        condition_index: Int[Tensor, " s"] | None = None,
    ) -> tuple[Float[Tensor, " s"], Float[Tensor, "s 3"]]:
        """Return density (1/m) and colour of samples."""
        return self.sample(positions, self.harmonics(directions), condition, condition_index)

    def sample(
        self,
        positions: Float[Tensor, "s 3"],
        harmonics: Float[Tensor, "s harmonics"],
        condition: Float[Tensor, "g c"] | None = None,
        condition_index: Int[Tensor, " s"] | None = None,
    ) -> tuple[Float[Tensor, " s"], Float[Tensor, "s 3"]]:
        """The same for encoded directions: the samples of a ray share one encoding."""
        columns = self._columns(condition, condition_index)
        density, geometry = self._density(positions, columns)
        return density, torch.sigmoid(self.colour_network([harmonics, geometry, *columns]))

    def background(
        self,
        rays: Rays,
        condition: Float[Tensor, "g c"] | None = None,
        condition_index: Int[Tensor, " rays"] | None = None,
    ) -> Float[Tensor, "rays 3"]:
        """Return the colour of what lies beyond the box along each ray."""
        return self.beyond(rays, self._columns(condition, condition_index))
