"""The radiance field: hash grid -> density network -> colour network, both optionally conditioned.

density(x, c) = exp(bounded(raw(x, c))), 1/m; rgb(x, d, c) in [0, 1]; x world metres, d unit direction, c a condition
vector such as a scene latent. c enters both networks after the hash grid, which all conditions share (CARFF B.3).
A condition is given per sample ([s, c]) or per group with the group of every sample ([g, c] and [s]): the second form
multiplies each condition with the weights once instead of once a sample.
"""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional as F

from hashnerf.activations import at_least_float32, truncated_exp
from hashnerf.errors import UserError
from hashnerf.hash_grid import HashGrid
from hashnerf.spherical_harmonics import MAX_DEGREE, spherical_harmonics


@dataclass(frozen=True)
class FieldConfig:
    """Capacity of a radiance field."""

    levels: int = 8
    """Resolutions of the hash grid."""
    features_per_level: int = 2
    """Features stored per vertex (even)."""
    log2_table_size: int = 17
    """Each level stores at most 2 to this power vertices; vertices beyond share entries."""
    base_resolution: int = 16
    """Cells along the longest side of the scene box at the coarsest level."""
    finest_resolution: int = 512
    """Cells along the longest side of the scene box at the finest level."""
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
    initial_thickness: float = 10.0
    """Optical thickness of the box along its longest side before training."""
    mlp_dtype: Literal["float32", "bfloat16"] = "float32"
    """Arithmetic of the networks; everything else stays float32."""
    compile: bool = False
    """Compile the hash grid with torch.compile where a compiler works."""

    def __post_init__(self):
        whole = ("levels", "features_per_level", "base_resolution", "hidden_width", "density_layers", "colour_layers")
        for name in whole:
            if getattr(self, name) < 1:
                raise UserError(f"field.{name} is {getattr(self, name)}: use at least 1")
        if self.features_per_level % 2:
            raise UserError(f"field.features_per_level is {self.features_per_level}: use an even number")
        if not 4 <= self.log2_table_size <= 28:
            raise UserError(f"field.log2_table_size is {self.log2_table_size}: use 4 to 28")
        if self.finest_resolution < self.base_resolution:
            raise UserError(
                f"field.finest_resolution is {self.finest_resolution}: use at least base_resolution, "
                f"{self.base_resolution}"
            )
        if not 1 <= self.direction_degree <= MAX_DEGREE:
            raise UserError(f"field.direction_degree is {self.direction_degree}: use 1 to {MAX_DEGREE}")
        if self.geometry_features < 0:
            raise UserError(f"field.geometry_features is {self.geometry_features}: use 0 or more")
        if not 0 < self.initial_thickness < math.inf:
            raise UserError(f"field.initial_thickness is {self.initial_thickness}: use a positive number")


class ConditionedLinear(nn.Module):
    """W x + V c + b, where V c is computed once per group of samples that share the condition c."""

    def __init__(self, inputs: int, condition_size: int, outputs: int):
        super().__init__()
        self.inputs = nn.Linear(inputs, outputs)
        self.condition = nn.Linear(condition_size, outputs, bias=False) if condition_size else None

    def forward(
        self,
        x: Float[Tensor, "s inputs"],
        condition: Float[Tensor, "g c"] | None,
        index: Int[Tensor, " s"] | None,
    ) -> Float[Tensor, "s outputs"]:
        """Apply the layer; `index` names each sample's row of `condition`, None means row by row."""
        out = self.inputs(x)
        if self.condition is None:
            return out
        shift = self.condition(condition)
        return out + (shift if index is None else shift.index_select(0, index))


class ConditionedMLP(nn.Module):
    """ReLU network whose first layer also reads the condition."""

    def __init__(self, inputs: int, condition_size: int, width: int, layers: int, outputs: int):
        super().__init__()
        self.first = ConditionedLinear(inputs, condition_size, width)
        rest: list[nn.Module] = [nn.ReLU()]
        for _ in range(layers - 1):
            rest += [nn.Linear(width, width), nn.ReLU()]
        self.rest = nn.Sequential(*rest, nn.Linear(width, outputs))

    def forward(
        self,
        x: Float[Tensor, "s inputs"],
        condition: Float[Tensor, "g c"] | None,
        index: Int[Tensor, " s"] | None,
    ) -> Float[Tensor, "s outputs"]:
        """Apply the network."""
        return self.rest(self.first(x, condition, index))

    def first_output_bank(
        self, x: Float[Tensor, "s inputs"], conditions: Float[Tensor, "bank c"] | None
    ) -> Float[Tensor, "bank_or_one s"]:
        """Return the first output at each sample under each condition of a bank; what conditions share is done once."""
        shared = self.first.inputs(x)
        shifts = [torch.zeros_like(shared[0])] if conditions is None else self.first.condition(conditions)
        last = self.rest[-1]
        # One condition at a time: its hidden values stay in the cache.
        rows = [F.linear(self.rest[:-1](shared + shift), last.weight[:1], last.bias[:1])[:, 0] for shift in shifts]
        return torch.stack(rows)


class Field(nn.Module):
    """A conditioned radiance field over a box (metres)."""

    def __init__(self, config: FieldConfig, scene_box: Float[Tensor, "2 3"], condition_size: int = 0):
        super().__init__()
        self.config, self.condition_size = config, condition_size
        self.hash_grid = HashGrid(
            scene_box.float(),
            config.levels,
            config.features_per_level,
            config.log2_table_size,
            config.base_resolution,
            config.finest_resolution,
            config.compile,
        )
        # weights of the table start near zero, so this bias alone sets the density everywhere
        longest = float((scene_box[1] - scene_box[0]).amax())
        self.log_initial_density = math.log(config.initial_thickness / longest)
        width, harmonics = config.hidden_width, config.direction_degree**2
        features = config.geometry_features
        self.density_network = ConditionedMLP(
            self.hash_grid.out_features, condition_size, width, config.density_layers, 1 + features
        )
        self.colour_network = ConditionedMLP(harmonics + features, condition_size, width, config.colour_layers, 3)
        self.background_layer = ConditionedLinear(harmonics, condition_size, 3)

    @property
    def box(self) -> Float[Tensor, "2 3"]:
        """The region the field models, metres."""
        return self.hash_grid.box

    def _autocast(self, device: torch.device) -> torch.autocast:
        low = self.config.mlp_dtype == "bfloat16"
        return torch.autocast(device.type, dtype=torch.bfloat16, enabled=low)

    def _check(self, condition: Tensor | None) -> None:
        size = 0 if condition is None else condition.shape[1]
        if size != self.condition_size:
            raise ValueError(f"the field takes conditions of length {self.condition_size}, not {size}")

    def density(
        self,
        positions: Float[Tensor, "s 3"],
        condition: Float[Tensor, "g c"] | None = None,
        condition_index: Int[Tensor, " s"] | None = None,
    ) -> tuple[Float[Tensor, " s"], Float[Tensor, "s features"]]:
        """Return density (1/m) and the geometry features that the colour network reads."""
        return self._density_of_features(self.hash_grid(positions), condition, condition_index)

    def _density_of_features(
        self, features: Tensor, condition: Tensor | None, index: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        self._check(condition)
        with self._autocast(features.device):
            out = self.density_network(features, condition, index)
        return truncated_exp(at_least_float32(out[:, 0]) + self.log_initial_density), out[:, 1:]

    def density_bank(
        self, positions: Float[Tensor, "p 3"], conditions: Float[Tensor, "bank c"] | None
    ) -> Float[Tensor, "bank_or_one p"]:
        """Return the density (1/m) at each position under each condition of a bank; positions are encoded once."""
        self._check(conditions)
        features = self.hash_grid(positions)
        with self._autocast(features.device):
            out = self.density_network.first_output_bank(features, conditions)
        return truncated_exp(at_least_float32(out) + self.log_initial_density)

    def forward(
        self,
        positions: Float[Tensor, "s 3"],
        directions: Float[Tensor, "s 3"],
        condition: Float[Tensor, "g c"] | None = None,
        condition_index: Int[Tensor, " s"] | None = None,
    ) -> tuple[Float[Tensor, " s"], Float[Tensor, "s 3"]]:
        """Return density (1/m) and colour of samples."""
        density, geometry = self.density(positions, condition, condition_index)
        harmonics = spherical_harmonics(directions, self.config.direction_degree)
        with self._autocast(positions.device):
            inputs = torch.cat([harmonics.to(geometry.dtype), geometry], dim=1)
            out = self.colour_network(inputs, condition, condition_index)
        return density, torch.sigmoid(at_least_float32(out))

    def background(
        self,
        directions: Float[Tensor, "rays 3"],
        condition: Float[Tensor, "g c"] | None = None,
        condition_index: Int[Tensor, " rays"] | None = None,
    ) -> Float[Tensor, "rays 3"]:
        """Return the colour of what lies beyond the box in each direction."""
        self._check(condition)
        harmonics = spherical_harmonics(directions, self.config.direction_degree)
        with self._autocast(directions.device):
            out = self.background_layer(harmonics, condition, condition_index)
        return torch.sigmoid(at_least_float32(out))
