"""Stage 1: the PC-VAE's training loop (CARFF 3.1, B.1; Eq. 2 with the usual signs: squared error plus weighted KL)."""

import math
from pathlib import Path

import torch
from jaxtyping import Int
from torch import Tensor
from torch.nn.utils import clip_grad_norm_

from carff.beliefs import kl_to_standard_normal, reparameterise
from carff.pcvae import Pcvae, PcvaeConfig
from carff.schedules import delayed_linear
from carff.states import StateTable, ambiguous_groups, state_chances
from carff.view_priority import ViewPriority
from hashnerf.errors import UserError
from hashnerf.finite_steps import FiniteSteps
from hashnerf.low_precision import without_autocast
from hashnerf.model_files import save_model
from hashnerf.posed_images import PosedImages
from hashnerf.training_run import TrainingRun

LOG_EVERY = 10
WARM_UP = 50  # steps
# Adam divides the gradient's scale out again, but adds 1e-8 first, and an error of 1e-3 has gradients not far above it.
LOSS_SCALE = 1e3
GRADIENT_LIMIT = 10.0


@without_autocast
def train_pcvae(
    config: PcvaeConfig,
    pcvae: Pcvae,
    data: PosedImages,
    table: StateTable,
    folder: Path,
    record: dict,
    seed: int,
    overwrite: bool = False,
) -> None:
    """Trains on the `train` views of `data` in a run folder and saves the model there.

    `record` is what the run folder keeps as its config. Batches depend on the run's generators alone, which checkpoints
    carry: a resumed run takes the path of an uninterrupted one.
    """
    device = next(pcvae.parameters()).device
    view_index = table.view_index("train")
    states, cameras = (view_index >= 0).nonzero(as_tuple=True)
    if len(states) == 0:
        raise UserError(f"{data.folder}: no view has the split `train`; give it to most cameras in transforms.json")
    frames = view_index[states, cameras]
    pcvae.decoder.fit_basis(data.images, view_index)
    prepared = pcvae.encoder.prepare(data.images[frames])
    optimizer = torch.optim.Adam(pcvae.parameters(), lr=config.lr)
    generator = torch.Generator().manual_seed(seed)
    noise = torch.Generator(device=device).manual_seed(seed)
    guard = FiniteSteps()
    # Equal pictures of several states ask for all of them at once: on average the same gradient as asking for one of
    # them at random, without the noise of the choice, and what is left of a view's error can be unlearnt.
    chances = state_chances(ambiguous_groups(data.images, view_index), table.branch_weight[table.branch])
    wanted = chances[states, cameras].to(device)
    priority = ViewPriority(len(frames), config.hard_share, WARM_UP)
    objects = {"pcvae": pcvae, "optimizer": optimizer, "priority": priority}
    pcvae.train()
    generators = {"batches": generator, "noise": noise}
    with TrainingRun(folder, record, config.steps, objects, generators, config.save_every, overwrite=overwrite) as run:
        for step in run.steps():
            rows = priority.draw(config.batch_size, generator)
            belief = pcvae.encode_prepared(prepared[rows].to(device), generator)
            latents = reparameterise(belief, noise)
            errors = pcvae.decoder.reconstruction_errors(latents, wanted[rows], generator)
            priority.record(rows, errors.detach().cpu())
            error = errors.mean()
            divergence = kl_to_standard_normal(belief).mean()
            epoch = step * config.batch_size / len(frames)
            weight = delayed_linear(epoch, config.kl_start, config.kl_end, config.kl_ramp_start, config.kl_ramp_end)
            optimizer.param_groups[0]["lr"] = config.lr * rate_factor(step, config.steps)
            optimizer.zero_grad(set_to_none=True)
            (LOSS_SCALE * (error + weight * divergence)).backward()
            norm = clip_grad_norm_(pcvae.parameters(), GRADIENT_LIMIT)
            if guard.accepts(step, {"error": error.detach(), "kl": divergence.detach(), "gradient": norm}):
                optimizer.step()
            if step % LOG_EVERY == 0 or step + 1 == config.steps:
                psnr = even_psnr_db(pcvae, prepared, states, step)
                run.log(step, error=error, kl=divergence, kl_weight=weight, psnr=psnr, skipped=guard.skipped)
        save_model(folder, pcvae, run)
    pcvae.eval()


@torch.no_grad()
def even_psnr_db(pcvae: Pcvae, prepared: Tensor, states: Int[Tensor, " n"], step: int, count: int = 64) -> float:
    """Returns the PSNR (dB) of decoded posterior samples of `count` views drawn evenly, encoded without jitter.

    It is the mean squared error to the pictures of each view's own state, hidden or not. The training error asks for no
    more than a picture tells and favours hard views.
    """
    device = next(pcvae.parameters()).device
    generator = torch.Generator().manual_seed(step)
    rows = torch.randint(len(states), (count,), generator=generator)
    was_training = pcvae.training
    pcvae.eval()
    belief = pcvae.encode_prepared(prepared[rows].to(device)).to("cpu")
    latents = reparameterise(belief, generator).to(device)
    errors = pcvae.decoder.pixel_errors(latents, states[rows].to(device), generator)
    pcvae.train(was_training)
    return -10 * math.log10(max(float(errors.mean()), 1e-10))


def rate_factor(step: int, steps: int, warm_up: int = WARM_UP) -> float:
    """Returns a linear warm-up followed by a cosine fall to zero."""
    progress = step / max(steps, 1)
    return min(1.0, (step + 1) / warm_up) * 0.5 * (1 + math.cos(math.pi * progress))
