"""Stage 2: the latent-conditioned radiance field's training (CARFF 3.1, B.3, Eq. 3)."""

from pathlib import Path

import torch
from jaxtyping import Bool, Float, Int
from lightning_fabric import Fabric
from torch import Tensor

from carff.beliefs import view_distinctness
from carff.latent_bank import build_bank
from carff.nerf import LatentNerf, NerfConfig
from carff.state_rays import build_state_rays
from carff.states import StateTable
from carff.transitions import ViewBeliefs
from hashnerf.fit import FieldFit, RayBatch, fit_field
from hashnerf.model_files import save_model
from hashnerf.posed_images import PosedImages
from hashnerf.rays import Rays
from hashnerf.training_run import TrainingRun


def build_nerf(config: NerfConfig, beliefs: ViewBeliefs, scene_box: Float[Tensor, "2 3"], seed: int) -> LatentNerf:
    """Builds a radiance field whose latent bank holds the posteriors of the valid views."""
    states, cameras = beliefs.valid.nonzero(as_tuple=True)
    distinctness = view_distinctness(beliefs.means, beliefs.logvars, beliefs.valid)
    generator = torch.Generator().manual_seed(seed)
    mean, logvar = beliefs.means[states, cameras], beliefs.logvars[states, cameras]
    bank = build_bank(mean, logvar, states, distinctness[states, cameras], generator)
    nerf = LatentNerf(config, scene_box, mean.shape[1], len(mean))
    nerf.set_bank(bank)
    return nerf


def training_views(table: StateTable, held_out_kinds: tuple[str, ...] = ()) -> Int[Tensor, "states cameras"]:
    """Returns the train views, without the cameras of the held-out kinds."""
    view_index = table.view_index("train").clone()
    out: Bool[Tensor, " cameras"] = torch.tensor([kind in held_out_kinds for kind in table.camera_kinds])
    view_index[:, out] = -1
    return view_index


def train_nerf(
    config: NerfConfig,
    nerf: LatentNerf,
    data: PosedImages,
    view_index: Int[Tensor, "states cameras"],
    folder: Path,
    record: dict,
    steps: int,
    fabric: Fabric | None = None,
    overwrite: bool = False,
    known: Int[Tensor, "states cameras"] | None = None,
) -> None:
    """Trains on the given views in a run folder; the model saved there holds the averaged weights.

    `record` is what the run folder keeps as its config. `known` holds the views of an earlier training that this one
    continues: `config.new_share` of the rays, changed pixels apart, go through the other cameras.
    """
    rays = build_state_rays(data.images, data.cameras, view_index, known)
    bank = nerf.bank
    device = nerf.latent_centre.device
    usable = (view_index >= 0).any(dim=1).nonzero()[:, 0]
    fit = FieldFit(nerf.field, nerf.occupancy, config.fit, config.march, steps, fabric)

    def draw_batch(step: int, count: int, generator: torch.Generator) -> RayBatch:
        # Pictures and posteriors stay in main memory: what is drawn from them is drawn there.
        generator = torch.Generator().manual_seed(
            int(torch.randint(2**31, (1,), generator=generator, device=generator.device))
        )
        groups = config.latents_per_step
        order = torch.randperm(len(usable), generator=generator).repeat(-(-groups // len(usable)))[:groups]
        states = usable[order]
        latents = bank.draw(states, config.fresh_share(step), generator)
        of_ray = torch.arange(count) % groups
        drawn, colour = rays.draw(states[of_ray], config.changed_share, generator, config.new_share)
        moved = Rays(drawn.origins.to(device), drawn.directions.to(device))
        return RayBatch(moved, colour.to(device), nerf.condition(latents), of_ray.to(device))

    def condition_bank(step: int) -> Float[Tensor, "bank d"]:
        generator = torch.Generator().manual_seed(step)
        return nerf.condition(bank.draw(usable.repeat(config.bank_per_state), 1.0, generator))

    writes = fit.fabric.global_rank == 0
    every = config.save_every
    with TrainingRun(folder, record, steps, fit.objects, None, every, overwrite=overwrite, writes=writes) as run:
        fit_field(fit, draw_batch, condition_bank, run)
        if writes:
            with fit.average.applied():
                save_model(folder, nerf, run)
