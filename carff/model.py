"""A trained CARFF run, ready to look, forecast and decide; loads from a run folder alone."""

from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from carff.beliefs import Belief
from carff.config import CarffConfig
from carff.forecast import Forecast, roll_out
from carff.mdn import MDN
from carff.mdn_training import build_mdn
from carff.nerf import LatentNerf
from carff.pcvae import Pcvae
from carff.probe import UNKNOWN, Probe, ProbeConfig, box_thickness, build_candidates, calibrate
from carff.scene_info import SceneInfo, load_scene_info
from carff.stages import CONFIG, SCENE, device_of, load_pcvae
from hashnerf.command_line import load_config
from hashnerf.errors import UserError
from hashnerf.model_files import load_model

CALIBRATION_DRAWS = 32


@dataclass(frozen=True)
class CarffModel:
    """The three trained networks, the calibrated probe and the scene they know."""

    config: CarffConfig
    scene: SceneInfo
    pcvae: Pcvae
    nerf: LatentNerf
    mdn: MDN
    probe: Probe
    state_beliefs: Belief
    costs: dict[str, dict]
    """Seconds and peak memory of each stage's training."""

    def encode(self, pictures: UInt8[Tensor, "n h w 3"]) -> Belief:
        """Returns the belief of each picture, on the CPU."""
        cameras = self.scene.cameras
        if tuple(pictures.shape[1:3]) != (cameras.height, cameras.width):
            raise UserError(
                f"the model reads pictures of {cameras.width} x {cameras.height} pixels, "
                f"not {pictures.shape[2]} x {pictures.shape[1]}; resize them first"
            )
        return self.pcvae.encode(pictures).to("cpu")

    def forecast(self, belief: Belief, n: int, ahead: int, generator: torch.Generator) -> Forecast:
        """Returns `n` sampled futures of one belief, `ahead` steps far."""
        return roll_out(belief, self.mdn, self.probe, self.nerf.density, self.state_beliefs, n, ahead, generator)

    def probe_scores(self, latents: Float[Tensor, "n d"], at_once: int = 512) -> Float[Tensor, "n boxes"]:
        """Returns how occupied every candidate box is in the scene of each latent."""
        return torch.cat([self.probe.scores(part, self.nerf.density) for part in latents.split(at_once)])

    def probe_latents(self, latents: Float[Tensor, "n d"]) -> Int[Tensor, " n"]:
        """Returns the probed state of each latent's scene, -1 where unknown."""
        return self.probe.classify(self.probe_scores(latents))

    def hazards(self, scores: Float[Tensor, "n boxes"]) -> tuple[Bool[Tensor, " n"], Bool[Tensor, " n"]]:
        """Returns which probed scenes are hazards, and of which that is unknown."""
        flag = self.probe.agreed(scores, self.scene.known_hazard().long())
        return flag == 1, flag == UNKNOWN


def load_carff(folder: Path) -> CarffModel:
    """Loads a finished run; raises UserError naming the stage that is missing."""
    for name in (CONFIG, SCENE):
        if not (folder / name).is_file():
            raise UserError(f"{folder}: not a CARFF run (no {name}); train one first with scripts/train_pcvae.py")
    config = trained_config(folder)
    scene = load_scene_info(folder / SCENE)
    costs = {}
    pcvae, costs["pcvae"] = load_pcvae(config, scene)
    nerf, costs["nerf"] = load_nerf(config, scene)
    latent_size = config.pcvae.latent_size
    mdn, costs["mdn"] = load_model(folder / "mdn", lambda _: build_mdn(config.mdn, latent_size), "scripts/train_mdn.py")
    probe = calibrated_probe(config.probe, scene, nerf, config.seed)
    return CarffModel(config, scene, pcvae, nerf, mdn.eval(), probe, nerf.bank.state_beliefs(), costs)


def trained_config(folder: Path) -> CarffConfig:
    """Returns the config of a run folder, with every stage's part as that stage was trained.

    The run's own config is that of the stage which was called last, perhaps with other settings for the earlier ones.
    """
    parts = {}
    for stage in ("pcvae", "nerf", "mdn"):
        if (folder / stage / CONFIG).is_file():
            parts[stage] = getattr(load_config(CarffConfig, folder / stage / CONFIG), stage)
    # The folder may have been moved or renamed since it was written.
    return replace(load_config(CarffConfig, folder / CONFIG), runs=str(folder.parent), name=folder.name, **parts)


def load_nerf(config: CarffConfig, scene: SceneInfo, held_out: bool = False) -> tuple[LatentNerf, dict]:
    """Loads the radiance field (`held_out`: the one that has never seen the bird's-eye camera) and its cost."""
    further = config.folder / "nerf_birds_eye"
    stage = further if further.is_dir() and not held_out else config.folder / "nerf"
    nerf, cost = load_model(
        stage,
        lambda saved: LatentNerf(config.nerf, scene.scene_box, *saved["bank_mean"].shape[::-1]),
        "scripts/train_nerf.py",
    )
    return nerf.to(device_of(config)).eval(), cost


def calibrated_probe(config: ProbeConfig, scene: SceneInfo, nerf: LatentNerf, seed: int) -> Probe:
    """Calibrates the candidate boxes on posterior samples of the training views, whose states are known."""
    candidates = build_candidates([list(boxes) for boxes in scene.actors], config)
    generator = torch.Generator().manual_seed(seed)
    states = torch.arange(len(scene.states)).repeat(CALIBRATION_DRAWS)
    latents = nerf.bank.draw(states, 1.0, generator)
    thickness = torch.cat([box_thickness(candidates, part, nerf.density) for part in latents.split(64)])
    return calibrate(candidates, thickness, states, config.min_confidence)
