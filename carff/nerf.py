"""The latent-conditioned radiance field: a scene latent in, a 3-D scene to look at and to probe out (CARFF Eq. 1, B.3).

The latent, standardised by the statistics of the training posteriors, is the condition of `hashnerf.field.Field`: it
enters the density and the colour network after the hash grid that all states share. The posteriors of the training
views travel with the field (`bank`), so that a trained model needs no data set.
"""

from dataclasses import dataclass
from dataclasses import field as option

import torch
from jaxtyping import Float
from torch import Tensor, nn

from carff.latent_bank import LatentBank
from hashnerf.cameras import Cameras
from hashnerf.errors import UserError
from hashnerf.field import Field, FieldConfig
from hashnerf.fit import FitConfig
from hashnerf.marching import MarchSettings
from hashnerf.occupancy import OccupancyConfig, OccupancyGrid
from hashnerf.render import render_images


@dataclass(frozen=True)
class NerfConfig:
    """The radiance field and its training."""

    field: FieldConfig = option(default_factory=FieldConfig)
    """Capacity of the field."""
    occupancy: OccupancyConfig = option(default_factory=OccupancyConfig)
    """The grid that skips empty space."""
    march: MarchSettings = option(default_factory=MarchSettings)
    """How rays are sampled."""
    fit: FitConfig = option(default_factory=FitConfig)
    """Optimiser and batch."""
    steps: int = 2000
    """Training steps."""
    latents_per_step: int = 12
    """Latents drawn per step; the rays are shared out among them."""
    changed_share: float = 0.5
    """Share of the rays through pixels where the states of a camera differ."""
    fresh_start: float = 0.0
    """Progress (0 to 1) up to which every latent is its view's fixed sample."""
    fresh_end: float = 0.5
    """Progress from which every latent is a fresh posterior sample."""
    bank_per_state: int = 1
    """Latents per state that the occupancy grid covers at each update."""
    birds_eye_steps: int = 0
    """Further steps on a copy of the field that also sees the bird's-eye camera (the paper trains on it)."""
    new_share: float = 0.5
    """Share of the rays of those steps, changed pixels apart, that go through the bird's-eye camera."""
    supersample: int = 1
    """Rays per pixel along each axis when a picture is rendered, as a pixel is the mean over an area; training: one."""
    save_every: int = 500
    """Steps between checkpoints."""

    def __post_init__(self):
        for key in ("steps", "latents_per_step", "bank_per_state", "supersample", "save_every"):
            if getattr(self, key) < 1:
                raise UserError(f"nerf.{key} is {getattr(self, key)}; give at least 1")
        if self.birds_eye_steps < 0:
            raise UserError(f"nerf.birds_eye_steps is {self.birds_eye_steps}; give 0 (none) or more")
        for key in ("changed_share", "new_share"):
            if not 0 <= getattr(self, key) <= 1:
                raise UserError(f"nerf.{key} is {getattr(self, key)}; give a value from 0 to 1")
        if not 0 <= self.fresh_start <= self.fresh_end:
            raise UserError(f"nerf.fresh_end is {self.fresh_end}; give at least fresh_start = {self.fresh_start}")

    def fresh_share(self, step: int) -> float:
        """Returns the probability that a latent is freshly sampled at a step (CARFF B.3)."""
        progress = step / self.steps
        if progress >= self.fresh_end:
            return 1.0
        return max(0.0, progress - self.fresh_start) / max(self.fresh_end - self.fresh_start, 1e-9)


class LatentNerf(nn.Module):
    """Field, occupancy grid and latent bank."""

    def __init__(self, config: NerfConfig, scene_box: Float[Tensor, "2 3"], latent_size: int, views: int):
        super().__init__()
        self.config = config
        self.field = Field(config.field, scene_box, latent_size)
        self.occupancy = OccupancyGrid(config.occupancy, scene_box)
        self.register_buffer("bank_mean", torch.zeros(views, latent_size))
        self.register_buffer("bank_logvar", torch.zeros(views, latent_size))
        self.register_buffer("bank_state", torch.zeros(views, dtype=torch.int64))
        self.register_buffer("bank_weight", torch.zeros(views))
        self.register_buffer("bank_fixed", torch.zeros(views, latent_size))
        self.register_buffer("latent_centre", torch.zeros(latent_size))
        self.register_buffer("latent_scale", torch.ones(latent_size))

    def set_bank(self, bank: LatentBank) -> None:
        """Stores the training posteriors and the statistics by which latents are standardised."""
        self.bank_mean.copy_(bank.mean)
        self.bank_logvar.copy_(bank.logvar)
        self.bank_state.copy_(bank.state)
        self.bank_weight.copy_(bank.weight)
        self.bank_fixed.copy_(bank.fixed)
        weight = bank.weight[:, None] / bank.weight.sum()
        centre = (weight * bank.mean).sum(dim=0)
        variance = (weight * ((bank.mean - centre).square() + bank.logvar.exp())).sum(dim=0)
        self.latent_centre.copy_(centre)
        self.latent_scale.copy_(variance.sqrt().clamp(min=1e-3))

    @property
    def bank(self) -> LatentBank:
        """The training posteriors."""
        return LatentBank(
            self.bank_mean.cpu(),
            self.bank_logvar.cpu(),
            self.bank_state.cpu(),
            self.bank_weight.cpu(),
            self.bank_fixed.cpu(),
        )

    def condition(self, latents: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Returns standardised latents, on the field's device."""
        return (latents.to(self.latent_centre.device) - self.latent_centre) / self.latent_scale

    @torch.no_grad()
    def density(self, points: Float[Tensor, "points 3"], latents: Float[Tensor, "n d"]) -> Float[Tensor, "n points"]:
        """Returns the density (1/m) of every latent's scene at world points."""
        return self.field.density_bank(points.to(self.latent_centre.device), self.condition(latents)).cpu()

    @torch.no_grad()
    def picture(self, latent: Float[Tensor, " d"], cameras: Cameras, index: int) -> Float[Tensor, "h w 3"]:
        """Returns what a camera sees of the scene that one latent describes, on the CPU."""
        row = self.condition(latent[None])
        cameras = cameras.to(row.device)

        def index_of(x: Tensor) -> Tensor:
            return torch.zeros(len(x), dtype=torch.int64, device=x.device)

        seen = render_images(
            cameras,
            [index],
            lambda x, d, ray: self.field(x, d, row, index_of(x)),
            self.occupancy,
            self.config.march,
            lambda rays: self.field.background(rays, row, index_of(rays.directions)),
            density_fn=lambda x, ray: self.field.density(x, row, index_of(x))[0],
            supersample=self.config.supersample,
        )
        return seen.rgb.cpu().view(cameras.height, cameras.width, 3)
