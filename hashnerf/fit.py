"""Fitting a radiance field to posed images: one loop, resumable bit for bit, on one or several processes.

The core does not know what a condition means: the caller's `draw_batch` gives rays, colours and condition vectors, and
`condition_bank` the conditions that the occupancy grid must cover. Randomness is a function of (seed, step, process)
alone, so that nothing random needs saving.
"""

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import torch
from jaxtyping import Float, Int
from lightning_fabric import Fabric
from torch import Tensor, nn
from torch.profiler import record_function

from hashnerf.errors import UserError
from hashnerf.field import Field
from hashnerf.finite_steps import FiniteSteps
from hashnerf.known_surfaces import distance_error, standing
from hashnerf.low_precision import without_autocast
from hashnerf.marching import MOST_SAMPLES_PER_OPACITY, MarchSettings
from hashnerf.occupancy import OccupancyGrid
from hashnerf.rays import Rays
from hashnerf.render import Rendering, render
from hashnerf.training_run import TrainingRun
from hashnerf.weight_average import WeightAverage

# as a profile names the parts of a step
OCCUPANCY, DRAW, STEP = "occupancy grid", "rays and colours", "step"
BACKWARD, UPDATE = "backward", "optimiser and average"
EMPTY_TURNS = 16  # while the grid is empty one step in this many samples everywhere, so that the field can come back
EMPTY_RAYS = 0.5  # share of the first step's rays of a step meanwhile: a background alone needs no more


@dataclass(frozen=True)
class FitConfig:
    """How a radiance field is trained."""

    learning_rate: float = 0.1
    """Adam's step at the start for the hash table and the background. A small one leaves fog for long; a large one kept
    up for thousands of steps brings it back (docs/results/notes.md)."""
    network_learning_rate: float = 0.006
    """Adam's step at the start for the networks; much larger ones are unstable."""
    final_share: float = 0.1
    """Share of both steps that is left at the end, reached exponentially."""
    loss: Literal["mse", "huber"] = "huber"
    """Colour error: squared, or squared up to 0.1 and linear beyond."""
    average_decay: float = 0.95
    """Decay of the moving average of the weights that is used for rendering."""
    rays: int = 2048
    """Rays of the first step."""
    most_rays: int = 16384
    """Most rays of a step."""
    batch_samples: int = 1 << 16
    """Samples a step should have: the number of rays adapts to it."""
    first_samples_per_opacity: float = 4.0
    """`march.samples_per_opacity` of the first step; it changes geometrically to the march's own. While all is fog many
    rays teach more than many samples a ray. Too few make the fog last: a thin surface that is hit by chance gives noisy
    colours, a thick one does not (docs/results/notes.md). No effect with `march.samples` 0."""
    distance_weight: float = 0.1
    """Weight of the error of known distances (per metre), where a batch has any."""
    empty_weight: float = 0.01
    """Weight of what stands at points known to be empty, where a batch has any."""
    opacity_weight: float = 0.0
    """Weight of the rays' mean opacity: fog in the colours of the background is as good as none for the pictures, and
    this decides for none."""
    occupancy_every: int = 16
    """Steps between updates of the occupancy grid."""
    log_every: int = 20
    """Steps between lines in the metrics."""
    seed: int = 0
    """Seed of everything random in the fit."""

    def __post_init__(self):
        for name in ("learning_rate", "network_learning_rate", "final_share"):
            if not 0 < getattr(self, name) < math.inf:
                raise UserError(f"fit.{name} is {getattr(self, name)}: use a positive number")
        for name in ("distance_weight", "empty_weight", "opacity_weight"):
            if not 0 <= getattr(self, name) < math.inf:
                raise UserError(f"fit.{name} is {getattr(self, name)}: use 0 or a positive number")
        if not 0 <= self.average_decay < 1:
            raise UserError(f"fit.average_decay is {self.average_decay}: use 0 (no average) or more and less than 1")
        if not 0 < self.first_samples_per_opacity <= MOST_SAMPLES_PER_OPACITY:
            raise UserError(
                f"fit.first_samples_per_opacity is {self.first_samples_per_opacity}: use a positive number up to 1e6"
            )
        for name in ("rays", "most_rays", "batch_samples", "occupancy_every", "log_every"):
            if getattr(self, name) < 1:
                raise UserError(f"fit.{name} is {getattr(self, name)}: use at least 1")


@dataclass(frozen=True)
class RayBatch:
    """What one step learns from."""

    rays: Rays
    """Rays of any cameras."""
    rgb: Float[Tensor, "rays 3"]
    """Their true colours in [0, 1]."""
    conditions: Float[Tensor, "groups c"] | None = None
    """Condition vectors used in this batch."""
    condition_index: Int[Tensor, " rays"] | None = None
    """Row of `conditions` of each ray."""
    weight: Float[Tensor, " rays"] | None = None
    """Weight of each ray's colour error; 1 if absent."""
    distance: Float[Tensor, " rays"] | None = None
    """Distance at which each ray is known to hit a surface (m), NaN where that is not known."""
    empty: Float[Tensor, "points 3"] | None = None
    """Points where nothing stands (m); of unconditioned fields only."""
    empty_share: float = 1.0
    """Weight of these points beside the usual one: whoever tells them in every fourth step tells them at 4."""


DrawBatch = Callable[[int, int, torch.Generator], RayBatch]
ConditionBank = Callable[[int], Tensor | None]


class _Loss(nn.Module):
    """One module whose forward pass is a step's loss: data-parallel wrappers see every parameter through it."""

    def __init__(self, field: Field, config: FitConfig):
        super().__init__()
        self.field, self.config = field, config

    def forward(
        self, batch: RayBatch, occupancy: OccupancyGrid, settings: MarchSettings, generator: torch.Generator | None
    ) -> tuple[Tensor, Tensor, int]:
        """Return the loss, the mean squared error per channel and the samples evaluated."""
        seen = render_batch(self.field, batch, occupancy, settings, generator)
        difference = seen.rgb - batch.rgb
        squared = difference.square().mean(dim=1)
        error = squared if self.config.loss == "mse" else _huber(difference).mean(dim=1)
        loss = (error if batch.weight is None else error * batch.weight).mean()
        if batch.distance is not None:
            loss = loss + self.config.distance_weight * distance_error(seen, batch.distance)
        if self.config.opacity_weight:
            loss = loss + self.config.opacity_weight * seen.opacity.mean()
        if batch.empty is not None:
            loss = loss + self.config.empty_weight * batch.empty_share * standing(self.field, batch.empty)
        return loss, squared.detach().mean(), seen.samples_evaluated


def _huber(difference: Tensor) -> Tensor:
    return nn.functional.huber_loss(difference, torch.zeros_like(difference), reduction="none", delta=0.1)


def render_batch(
    field: Field,
    batch: RayBatch,
    occupancy: OccupancyGrid,
    settings: MarchSettings,
    generator: torch.Generator | None = None,
) -> Rendering:
    """Render the rays of a batch, each under its condition."""
    rows, of_ray = batch.conditions, batch.condition_index
    harmonics = field.harmonics(batch.rays.directions)

    def field_fn(positions: Tensor, directions: Tensor, ray_index: Tensor) -> tuple[Tensor, Tensor]:
        of_sample = None if of_ray is None else of_ray.index_select(0, ray_index)
        return field.sample(positions, harmonics.index_select(0, ray_index), rows, of_sample)

    def density_fn(positions: Tensor, ray_index: Tensor) -> Tensor:
        return field.density(positions, rows, None if of_ray is None else of_ray.index_select(0, ray_index))[0]

    def background_fn(rays: Rays) -> Tensor:
        return field.background(rays, rows, of_ray)

    return render(batch.rays, field_fn, occupancy, settings, background_fn, generator, density_fn)


class FieldFit:
    """A field being fitted: optimiser, weight average and step size; `objects` is what a training run must save."""

    def __init__(
        self,
        field: Field,
        occupancy: OccupancyGrid,
        config: FitConfig,
        settings: MarchSettings,
        total_steps: int,
        fabric: Fabric | None = None,
        further: Sequence[Mapping] = (),
    ):
        """`further` are groups of parameters beside the field's own: `params`, and `start`, their first step."""
        if any(p.dtype in (torch.float16, torch.bfloat16) for p in field.parameters()):
            raise ValueError("the field's weights are in half precision: Adam needs float32 weights")
        self.config, self.settings, self.total_steps = config, settings, total_steps
        self.fabric = fabric or Fabric(accelerator="cpu", devices=1)
        self.field, self.occupancy = field, occupancy.to(self.fabric.device)
        networks = [*field.density_network.parameters(), *field.colour_network.parameters()]
        # the background must learn at once: what it cannot show yet appears as fog inside the box
        quick = [field.hash_grid.table, *field.beyond.parameters()]
        groups = [
            {"params": quick, "start": config.learning_rate},
            {"params": networks, "start": config.network_learning_rate},
            *(dict(group) for group in further),
        ]
        optimizer = torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-15, fused=True)
        self.loss, self.optimizer = self.fabric.setup(_Loss(field, config), optimizer)
        self.average = WeightAverage(field, config.average_decay)
        self.finite = FiniteSteps()
        self.samples_per_ray = 0.0  # running mean

    @property
    def objects(self) -> dict:
        """Everything whose state a checkpoint must hold, by name."""
        return {"field": self.field, "occupancy": self.occupancy, "fit": self}

    def state_dict(self) -> dict:
        """Optimiser, weight average and running mean of samples."""
        return {
            "optimizer": self.optimizer.optimizer.state_dict(),
            "average": self.average.state_dict(),
            "samples_per_ray": self.samples_per_ray,
        }

    def load_state_dict(self, state: dict) -> None:
        """Continue from a saved state."""
        self.optimizer.optimizer.load_state_dict(state["optimizer"])
        self.average.load_state_dict(state["average"])
        self.samples_per_ray = state["samples_per_ray"]

    def rays_wanted(self) -> int:
        """Rays that give about the wanted number of samples."""
        if not self.samples_per_ray:
            return self.config.rays
        return max(1, min(self.config.most_rays, round(self.config.batch_samples / self.samples_per_ray)))

    def generator(self, step: int) -> torch.Generator:
        """The source of randomness of one step of this process."""
        # hashed, because the generator of a processor uses only the lowest 32 bits of its seed
        digest = hashlib.sha256(f"{self.config.seed} {step} {self.fabric.global_rank}".encode()).digest()
        return torch.Generator(device=self.fabric.device).manual_seed(int.from_bytes(digest[:4], "big"))

    def update_occupancy(self, conditions: Tensor | None) -> None:
        """Refresh the occupancy grid for a bank of conditions."""
        self.occupancy.update(lambda positions: self.field.density_bank(positions, conditions))

    def _march_settings(self, progress: float) -> MarchSettings:
        first, last = self.config.first_samples_per_opacity, self.settings.samples_per_opacity
        return replace(self.settings, samples_per_opacity=first * (last / first) ** progress)

    @without_autocast
    def step(self, step: int, batch: RayBatch, generator: torch.Generator | None) -> dict[str, float]:
        """Take one optimiser step (or skip it if anything is not finite) and return metrics over all processes."""
        if not (batch.rays.origins.isfinite().all() and batch.rays.directions.isfinite().all()):
            # no sample can be placed on such a ray, so there is no loss to skip the step by
            raise UserError(f"training broke down at step {step}: rays not finite; check the poses")
        progress = min(step / max(self.total_steps, 1), 1.0)
        for group in self.optimizer.param_groups:
            group["lr"] = group["start"] * self.config.final_share**progress
        self.optimizer.zero_grad()
        empty = self.occupancy.is_empty()
        occupancy = self.occupancy.unseen() if empty and step % EMPTY_TURNS == 0 else self.occupancy
        loss, squared, samples = self.loss(batch, occupancy, self._march_settings(progress), generator)
        with record_function(BACKWARD):
            self.fabric.backward(loss)
        # of every group, also those beside the field: poses with a NaN would be lost as weights are
        learnt = [parameter for group in self.optimizer.param_groups for parameter in group["params"]]
        gradient = torch.nn.utils.get_total_norm([p.grad for p in learnt if p.grad is not None])
        numbers = torch.stack([loss.detach(), squared, loss.new_tensor(samples), loss.new_tensor(len(batch.rays))])
        # one process must not skip a step that the others take, nor draw another number of rays
        mean_loss, mean_squared, mean_samples, mean_rays = self.fabric.all_reduce(numbers, reduce_op="mean").tolist()
        if self.finite.accepts(step, {"colour loss": mean_loss, "gradient": gradient}):
            with record_function(UPDATE):
                self.optimizer.step()
                self.average.update()
        a_ray = mean_samples / max(mean_rays, 1)
        if empty:  # no sample to a ray must not ask for ever more rays
            self.samples_per_ray = self.config.batch_samples / max(EMPTY_RAYS * self.config.rays, 1)
        else:
            self.samples_per_ray = a_ray if not self.samples_per_ray else 0.8 * self.samples_per_ray + 0.2 * a_ray
        return {
            "loss": mean_loss,
            "psnr": -10 * math.log10(max(mean_squared, 1e-12)) if math.isfinite(mean_squared) else math.nan,
            "rays": round(mean_rays),
            "samples": round(mean_samples),
            "skipped": self.finite.skipped,
        }


def fit_field(fit: FieldFit, draw_batch: DrawBatch, condition_bank: ConditionBank, run: TrainingRun) -> None:
    """Train until the run is over: `draw_batch(step, rays, generator)` gives about as many rays as asked."""
    for step in run.steps():
        if step % fit.config.occupancy_every == 0:
            with record_function(OCCUPANCY):
                fit.update_occupancy(condition_bank(step))
        generator = fit.generator(step)
        with record_function(DRAW):
            batch = draw_batch(step, fit.rays_wanted(), generator)
        with record_function(STEP):
            metrics = fit.step(step, batch, generator)
        if step % fit.config.log_every == 0:
            run.log(step, **metrics)
