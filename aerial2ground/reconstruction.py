"""Drone pictures and a road network become a radiance field (aerial2ground III-B, Alg. 1)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from dataclasses import field as option
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn

from aerial2ground.opaque_ground import make_ground_opaque
from aerial2ground.pose_refinement import PoseCorrections
from aerial2ground.road_network import RoadNetwork
from aerial2ground.road_prior import RoadPriorConfig, draw_prior
from hashnerf.baked_density import BakedDensity
from hashnerf.cameras import Cameras
from hashnerf.errors import UserError
from hashnerf.field import Field, FieldConfig
from hashnerf.fit import FieldFit, FitConfig, RayBatch, fit_field
from hashnerf.marching import MarchSettings
from hashnerf.model_files import save_model
from hashnerf.occupancy import OccupancyConfig, OccupancyGrid
from hashnerf.picture_rays import PictureRays
from hashnerf.posed_images import PosedImages
from hashnerf.rays import Rays
from hashnerf.render import Rendering, render_images
from hashnerf.training_run import TrainingRun

EMPTY_EVERY = 4
"""Steps between points of free space: to ask for the density of a few of them costs a tenth of a step."""


@dataclass(frozen=True)
class ReconstructionConfig:
    """The radiance field of a town and its training."""

    field: FieldConfig = option(default_factory=lambda: FieldConfig(finest_resolution=512, ground=True))
    """Capacity of the field."""
    occupancy: OccupancyConfig = option(default_factory=lambda: OccupancyConfig(cell=0.06))
    """The grid that skips empty space."""
    march: MarchSettings = option(default_factory=lambda: MarchSettings(candidates=128, even_distance=1.0, near=0.02))
    """How rays are sampled."""
    view_samples_per_opacity: float = 8.0
    """Samples for each interval expected to be opaque, or that guiding shows to be, when views are rendered; training
    needs more of them."""
    view_parts: int = 0
    """With a positive number guiding looks up stored densities when views are rendered: each occupied cell is cut into
    so many parts along x and y, and `field.flatness` times as many along z; 0 asks the field."""
    view_supersample: int = 1
    """Rays per pixel along each axis when views are rendered, as a pixel is the mean over an area; training: one."""
    fit: FitConfig = option(default_factory=FitConfig)
    """Optimiser and batch."""
    road_prior: RoadPriorConfig = option(default_factory=RoadPriorConfig)
    """What is known of roads."""
    steps: int = 2000
    """Training steps (paper: 5000)."""
    opaque_start: bool = False
    """Start with an opaque ground at the roads' height; for towns on flat ground."""
    refine_poses: bool = True
    """Correct the told poses while training."""
    position_learning_rate: float = 0.001
    """First step of the corrections of positions, metres."""
    orientation_learning_rate: float = 0.001
    """First step of the corrections of orientations, radians. A camera that turns a little and moves a little the
    other way takes almost the same picture of a ground: told errors are shared out as the two steps are, so the steps
    should be as the squares of those errors, where an angle counts by the distance to the ground."""
    pose_every: int = 4
    """Steps between corrections of poses: through the rays' positions, gradients cost a third of a step."""
    save_every: int = 500
    """Steps between checkpoints."""

    def __post_init__(self):
        if self.view_parts < 0:
            raise UserError(f"reconstruction.view_parts is {self.view_parts}; give 0 or more")
        for key in ("steps", "pose_every", "save_every", "view_supersample"):
            if getattr(self, key) < 1:
                raise UserError(f"reconstruction.{key} is {getattr(self, key)}; give at least 1")
        for key in ("position_learning_rate", "orientation_learning_rate"):
            if not 0 < getattr(self, key) < math.inf:
                raise UserError(f"reconstruction.{key} is {getattr(self, key)}; give a positive number")


class RoadNerf(nn.Module):
    """Field, occupancy grid and the corrections of the training cameras' poses."""

    def __init__(self, config: ReconstructionConfig, scene_box: Float[Tensor, "2 3"], cameras: int):
        super().__init__()
        self.config = config
        self.field = Field(config.field, scene_box)
        self.occupancy = OccupancyGrid(config.occupancy, scene_box)
        self.corrections = PoseCorrections(cameras)
        self.baked: BakedDensity | None = None

    def bake(self, pixels: int) -> None:
        """Stores densities, if `view_parts` asks for it and looking them up for `pixels` is less work than asking.

        To be called again after the field has changed.
        """
        parts, march = self.config.view_parts, self.config.march
        cut = (parts, parts, max(round(parts * self.config.field.flatness), 1))
        questions = int(self.occupancy.occupied().sum()) * math.prod(cut)
        asked = march.samples_per_opacity * self.config.view_supersample
        if parts and march.guided_per_opacity and questions < pixels * asked:
            self.baked = BakedDensity(self.occupancy, cut, lambda positions: self.field.density(positions)[0])

    def view(self, cameras: Cameras, index: int) -> Rendering:
        """Returns what a camera sees, rows h*w in row-major order; its matrix and lens are honoured."""
        return self.views(cameras, [index])

    @torch.no_grad()
    def views(self, cameras: Cameras, indices: Sequence[int]) -> Rendering:
        """Returns what some cameras see, rows n*h*w: small pictures take less time together."""
        march, fewer, finer = self.config.march, self.config.view_samples_per_opacity, self.config.view_supersample
        if march.guided_per_opacity:
            # rays of one pixel share the first look, too
            march = replace(march, samples_per_opacity=march.samples_per_opacity / finer, guided_per_opacity=fewer)
        else:
            march = replace(march, samples_per_opacity=fewer)
        return render_images(
            cameras,
            indices,
            self.colour_and_density,
            self.occupancy,
            march,
            self.field.background,
            density_fn=self.density,
            supersample=finer,
        )

    def density(self, positions: Tensor, ray_index: Tensor) -> Tensor:
        """Density as guided marching wants it: stored, if it was."""
        return self.baked(positions) if self.baked is not None else self.field.density(positions)[0]

    def colour_and_density(self, positions: Tensor, directions: Tensor, ray_index: Tensor) -> tuple[Tensor, Tensor]:
        """The field as rendering wants it."""
        return self.field(positions, directions)


def train_road_nerf(
    config: ReconstructionConfig,
    nerf: RoadNerf,
    data: PosedImages,
    network: RoadNetwork | None,
    folder: Path,
    record: dict,
    overwrite: bool = False,
) -> None:
    """Trains on the pictures of `data` (training ones only) in a run folder; averaged weights are saved there."""
    pictures = PictureRays.of(data)
    prior, refine = config.road_prior, config.refine_poses
    flying_height = float(data.cameras.pose[:, 2, 3].median()) - (network.height if network else 0.0)
    further = [
        {"params": [nerf.corrections.translation], "start": config.position_learning_rate},
        {"params": [nerf.corrections.rotation], "start": config.orientation_learning_rate},
    ]
    if config.opaque_start and network is not None:
        make_ground_opaque(nerf.field, network.height, config.fit.seed)
    fit = FieldFit(
        nerf.field, nerf.occupancy, config.fit, config.march, config.steps, further=further if refine else []
    )

    def draw_batch(step: int, count: int, generator: torch.Generator) -> RayBatch:
        extra = round(count * prior.share / (1 + prior.share)) if network is not None and prior.used else 0
        number, pixel = pictures.draw(count - extra, generator)
        with torch.set_grad_enabled(step % config.pose_every == 0):
            rays, colour = pictures.rays(number, pixel, nerf.corrections if refine else None)
        if not extra or network is None:
            return RayBatch(rays, colour)
        known = draw_prior(network, prior, flying_height, extra, generator)
        own = len(rays)
        return RayBatch(
            Rays(torch.cat([rays.origins, known.rays.origins]), torch.cat([rays.directions, known.rays.directions])),
            torch.cat([colour, known.rgb]),
            weight=torch.cat([torch.ones(own), known.weight]),
            distance=torch.cat([torch.full((own,), torch.nan), known.distance]),
            empty=known.empty if prior.free_space and step % EMPTY_EVERY == 0 else None,
            empty_share=float(EMPTY_EVERY),
        )

    objects = fit.objects | {"corrections": nerf.corrections}
    with TrainingRun(folder, record, config.steps, objects, None, config.save_every, overwrite=overwrite) as run:
        fit_field(fit, draw_batch, lambda step: None, run)
        with fit.average.applied():
            save_model(folder, nerf, run)
