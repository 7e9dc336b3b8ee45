"""The three training stages of CARFF on a data-set folder; each is resumable and does nothing when it is finished.

runs/<name>/{config.yaml, scene.json, pcvae/, nerf/, nerf_birds_eye/, mdn/}: `nerf` has never seen the bird's-eye
camera; `nerf_birds_eye` continues it with that camera among the training views, as in the paper, and is what forecasts
are rendered with.
"""

from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Int
from lightning_fabric import Fabric
from torch import Tensor

from carff.beliefs import require_latents
from carff.config import CarffConfig
from carff.dataset_summary import limits
from carff.mdn_training import build_mdn, train_mdn
from carff.nerf import NerfConfig
from carff.nerf_training import build_nerf, train_nerf, training_views
from carff.pcvae import Pcvae
from carff.pcvae_training import train_pcvae
from carff.scene_info import SceneInfo, scene_info
from carff.states import StateTable, build_state_table
from carff.transitions import TransitionSampler, ViewBeliefs
from hashnerf.capacity import with_capacity
from hashnerf.command_line import config_changes, plain_config, read_yaml, save_config, set_threads
from hashnerf.errors import UserError
from hashnerf.model_files import load_model
from hashnerf.posed_images import PosedImages, load_posed_images
from hashnerf.progress import say
from hashnerf.random_state import seed_everything
from hashnerf.training_run import begun_config

CONFIG, SCENE = "config.yaml", "scene.json"
BIRDS_EYE = "birds_eye"
SETTLED_SHARE = 0.2  # of the first learning rates, when a trained field goes on


def device_of(config: CarffConfig) -> torch.device:
    """Returns the device that the config asks for."""
    if config.device == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    return torch.device(config.device)


def load_data(config: CarffConfig) -> tuple[PosedImages, StateTable]:
    """Loads the data set and seeds everything."""
    set_threads(config.threads)
    seed_everything(config.seed)
    data = load_posed_images(Path(config.dataset), config.image_size or None)
    return data, build_state_table(data)


def describe_run(config: CarffConfig, data: PosedImages, table: StateTable) -> None:
    """Writes the run's config and scene description; only after a stage has accepted and finished its training.

    A command that is refused, because the run belongs to another data set or config, leaves a finished run as it was.
    """
    save_config(config, config.folder / CONFIG)
    scene_info(data, table).save(config.folder / SCENE)


def new_pcvae(config: CarffConfig, scene: SceneInfo) -> Pcvae:
    """Builds an untrained PC-VAE for a scene."""
    cameras = scene.cameras
    shape = (len(scene.states), cameras.height, cameras.width)
    return Pcvae(config.pcvae, cameras.pose, scene.scene_box, *shape).to(device_of(config))


def run_pcvae(config: CarffConfig) -> None:
    """Stage 1."""
    data, table = load_data(config)
    for reason in limits(table):
        say(f"{config.dataset}: {reason}.")
    pcvae = new_pcvae(config, scene_info(data, table))
    record = _record(config, "pcvae")
    train_pcvae(config.pcvae, pcvae, data, table, config.folder / "pcvae", record, config.seed, config.overwrite)
    describe_run(config, data, table)


def run_nerf(config: CarffConfig) -> None:
    """Stage 2: without the bird's-eye camera, then on with it."""
    data, table = load_data(config)
    pcvae = _pcvae_of_this_config(config, data, table)
    beliefs = encode_views(pcvae, data, table.view_index("train"))
    begun = begun_config(config.folder / "nerf", config.overwrite)
    train = data.split("train")
    full = with_capacity(config.nerf, begun and begun["nerf"], train.images, train.cameras, data.scene_box)
    config = replace(config, nerf=full)
    nerf = build_nerf(config.nerf, beliefs, data.scene_box, config.seed).to(device_of(config))
    fabric = Fabric(accelerator=device_of(config).type, devices=1)
    held_out = training_views(table, (BIRDS_EYE,))
    record = _record(config, "nerf")
    train_nerf(
        config.nerf, nerf, data, held_out, config.folder / "nerf", record, config.nerf.steps, fabric, config.overwrite
    )
    describe_run(config, data, table)
    more = config.nerf.birds_eye_steps
    views = training_views(table)
    if more == 0 or torch.equal(views, held_out):
        return
    load_model(config.folder / "nerf", lambda _: nerf, "scripts/train_nerf.py")
    train_nerf(
        settled(config.nerf),
        nerf,
        data,
        views,
        config.folder / "nerf_birds_eye",
        record,
        more,
        fabric,
        config.overwrite,
        held_out,
    )


def settled(config: NerfConfig) -> NerfConfig:
    """Returns the config by which a trained field goes on: small steps, fresh latents, all samples from the start."""
    fit = config.fit
    small = {name: getattr(fit, name) * SETTLED_SHARE for name in ("learning_rate", "network_learning_rate")}
    # few samples a ray would turn surfaces into fog again
    samples = config.march.samples_per_opacity
    further = replace(fit, **small, first_samples_per_opacity=samples, seed=fit.seed + 1)
    return replace(config, fresh_start=0.0, fresh_end=0.0, fit=further)


def run_mdn(config: CarffConfig) -> None:
    """Stage 3."""
    data, table = load_data(config)
    pcvae = _pcvae_of_this_config(config, data, table)
    beliefs = encode_views(pcvae, data, table.view_index("train"))
    mdn = build_mdn(config.mdn, pcvae.latent_size)
    weight = table.branch_weight[table.branch]
    poses = table.camera_poses
    sampler = TransitionSampler(beliefs, table.successor, poses, config.mdn.transitions, config.seed, weight)
    train_mdn(config.mdn, mdn, sampler, config.folder / "mdn", _record(config, "mdn"), config.overwrite)
    describe_run(config, data, table)


def _pcvae_of_this_config(config: CarffConfig, data: PosedImages, table: StateTable) -> Pcvae:
    """Loads the PC-VAE that a later stage builds on."""
    refuse_other_pcvae(config)
    return load_pcvae(config, scene_info(data, table))[0]


def refuse_other_pcvae(config: CarffConfig) -> None:
    """Raises UserError for a run whose PC-VAE is one of another data set, size, seed or training."""
    trained = config.folder / "pcvae" / CONFIG
    changes = config_changes(read_yaml(trained), _record(config, "pcvae")) if trained.is_file() else []
    if changes:
        raise UserError(
            f"{trained.parent}: the PC-VAE was trained with another config ({'; '.join(changes)}); give the same, "
            "or run scripts/train_pcvae.py first, under another name or with --overwrite true"
        )


def load_pcvae(config: CarffConfig, scene: SceneInfo) -> tuple[Pcvae, dict]:
    """Loads the trained PC-VAE of a run, and what its training cost."""
    folder = config.folder / "pcvae"
    pcvae, cost = load_model(folder, lambda _: new_pcvae(config, scene), "scripts/train_pcvae.py")
    return pcvae.eval(), cost


def encode_views(pcvae: Pcvae, data: PosedImages, view_index: Int[Tensor, "states cameras"]) -> ViewBeliefs:
    """Encodes every view in the index; raises UserError where the encoder's answers are of no use to later stages."""
    valid = view_index >= 0
    belief = pcvae.encode(data.images[view_index[valid]])
    require_latents(belief.mean, "means of the encoded views")
    shape = (*view_index.shape, pcvae.latent_size)
    means, logvars = torch.zeros(shape), torch.zeros(shape)
    means[valid], logvars[valid] = belief.mean.cpu(), belief.logvar.cpu()
    return ViewBeliefs(means, logvars, valid)


def _record(config: CarffConfig, stage: str) -> dict:
    """What a stage depends on: if it changes, the stage must be trained again."""
    names = {"pcvae": ("pcvae",), "nerf": ("pcvae", "nerf"), "mdn": ("pcvae", "mdn")}[stage]
    plain = plain_config(config)
    return {key: plain[key] for key in ("dataset", "image_size", "seed", *names)}
