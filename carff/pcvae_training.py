"""Stage 1: the PC-VAE's training loop (CARFF 3.1, B.1; Eq. 2 with the usual signs: squared error plus weighted KL)."""

import math
from pathlib import Path

import torch
from torch.nn.utils import clip_grad_norm_

from carff.beliefs import kl_to_standard_normal, reparameterise
from carff.model_files import save_model
from carff.pcvae import Pcvae, PcvaeConfig
from carff.schedules import delayed_linear
from carff.states import StateTable
from hashnerf.finite_steps import FiniteSteps
from hashnerf.posed_images import PosedImages
from hashnerf.training_run import TrainingRun

LOG_EVERY = 10
# Adam divides the gradient's scale out again, but adds 1e-8 first, and an error of 1e-3 has gradients not far above it.
LOSS_SCALE = 1e3
GRADIENT_LIMIT = 10.0


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
    frames = view_index[states, cameras]
    pcvae.decoder.fit_basis(data.images, view_index)
    prepared = pcvae.encoder.prepare(data.images[frames])
    optimizer = torch.optim.Adam(pcvae.parameters(), lr=config.lr)
    generator = torch.Generator().manual_seed(seed)
    noise = torch.Generator(device=device).manual_seed(seed)
    guard = FiniteSteps()
    objects = {"pcvae": pcvae, "optimizer": optimizer}
    pcvae.train()
    generators = {"batches": generator, "noise": noise}
    with TrainingRun(folder, record, config.steps, objects, generators, config.save_every, overwrite=overwrite) as run:
        for step in run.steps():
            rows = torch.randint(len(frames), (config.batch_size,), generator=generator)
            belief = pcvae.encode_prepared(prepared[rows].to(device), generator)
            latents = reparameterise(belief, noise)
            error = pcvae.decoder.reconstruction_loss(latents, states[rows].to(device), generator)
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
                psnr = -10 * math.log10(max(float(error.detach()), 1e-10))
                run.log(step, error=error, kl=divergence, kl_weight=weight, psnr=psnr, skipped=guard.skipped)
        save_model(folder, pcvae, run)
    pcvae.eval()


def rate_factor(step: int, steps: int, warm_up: int = 50) -> float:
    """Returns a linear warm-up followed by a cosine fall to zero."""
    progress = step / max(steps, 1)
    return min(1.0, (step + 1) / warm_up) * 0.5 * (1 + math.cos(math.pi * progress))
