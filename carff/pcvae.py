"""Pose-conditional variational auto-encoder: picture of a state -> belief over latents -> picture from any camera.

CARFF 3.1: the encoder sees camera c, the decoder is asked for camera c'', so the latent must describe the scene and not
the view. Latent size 8 (Table 4). A `Belief` is a diagonal Gaussian over latents (carff.beliefs).
"""

import math
from dataclasses import dataclass, field

import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor, nn

from carff.beliefs import Belief, bound_logvar
from carff.decoders import ComponentsDecoder, ConvDecoder, DecoderConfig, pose_code
from carff.encoders import EncoderConfig, build_encoder
from hashnerf.errors import UserError


@dataclass(frozen=True)
class PcvaeConfig:
    """The PC-VAE and its training (CARFF Table 4)."""

    latent_size: int = 8
    """Dimensions of the latent (paper: 8)."""
    encoder: EncoderConfig = field(default_factory=EncoderConfig)
    """Picture to belief."""
    decoder: DecoderConfig = field(default_factory=DecoderConfig)
    """Latent and camera to picture."""
    steps: int = 1000
    """Training steps."""
    batch_size: int = 64
    """Pictures encoded per step."""
    hard_share: float = 0.7
    """Share of the pictures of a step that are drawn in proportion to their error; the others are drawn evenly."""
    lr: float = 0.002
    """Peak learning rate of Adam; it falls to zero along a cosine."""
    kl_start: float = 1e-6
    """Weight of the KL term before the ramp (paper: 1e-6)."""
    kl_end: float = 4e-5
    """Weight of the KL term after the ramp (paper: 1e-5 to 4e-5, by data set)."""
    kl_ramp_start: float = 50.0
    """Epoch at which the weight begins to rise (paper: 50)."""
    kl_ramp_end: float = 80.0
    """Epoch at which the weight has reached its end (paper: 80)."""
    save_every: int = 500
    """Steps between checkpoints."""

    def __post_init__(self):
        for key in ("latent_size", "steps", "batch_size", "save_every"):
            if getattr(self, key) < 1:
                raise UserError(f"pcvae.{key} is {getattr(self, key)}; give at least 1")
        for key in ("kl_start", "kl_end"):
            if not 0 <= getattr(self, key) < math.inf:
                raise UserError(f"pcvae.{key} is {getattr(self, key)}; give 0 or a positive number")
        if not 0 <= self.hard_share <= 1:
            raise UserError(f"pcvae.hard_share is {self.hard_share}; give a value from 0 to 1")
        if not self.lr > 0:
            raise UserError(f"pcvae.lr is {self.lr}; give a positive learning rate")
        if self.kl_ramp_end < self.kl_ramp_start:
            raise UserError(f"pcvae.kl_ramp_end is {self.kl_ramp_end}, before kl_ramp_start {self.kl_ramp_start}")


class Pcvae(nn.Module):
    """Encoder and decoder; built from shapes alone, so that a checkpoint loads without its data set."""

    def __init__(
        self,
        config: PcvaeConfig,
        poses: Float[Tensor, "cameras 4 4"],
        scene_box: Float[Tensor, "2 3"],
        states: int,
        height: int,
        width: int,
    ):
        super().__init__()
        self.latent_size = config.latent_size
        self.encoder = build_encoder(config.encoder, config.latent_size, height, width)
        cameras = len(poses)
        if config.decoder.kind == "components":
            shape = (cameras, states, height, width)
            self.decoder = ComponentsDecoder(config.decoder, config.latent_size, *shape)
        else:
            if height != width:
                raise UserError(f"the conv decoder needs square pictures, not {width} x {height}")
            code = torch.eye(cameras) if config.decoder.camera == "one_hot" else pose_code(poses, scene_box)
            self.decoder = ConvDecoder(config.decoder, config.latent_size, code, width)
        # One scale for the last layer: beliefs start sharp (standard deviation e^-2), so the decoder sees a signal.
        with torch.no_grad():
            last = self.encoder.head[-1]
            last.bias[config.latent_size :] = -4.0

    def encode_prepared(self, prepared: Tensor, generator: torch.Generator | None = None) -> Belief:
        """Returns the beliefs of prepared pictures (`encoder.prepare`); a `generator` switches input jitter on."""
        raw = self.encoder(prepared, generator)
        mean, logvar = raw.split(self.latent_size, dim=-1)
        return Belief(mean, bound_logvar(logvar))

    @torch.no_grad()
    def encode(self, pictures: UInt8[Tensor, "n h w 3"], batch: int = 64) -> Belief:
        """Returns the beliefs of any number of pictures (inference)."""
        device = next(self.parameters()).device
        was_training = self.training
        self.eval()
        parts = [self.encode_prepared(self.encoder.prepare(part.to(device))) for part in pictures.split(batch)]
        self.train(was_training)
        return Belief(torch.cat([p.mean for p in parts]), torch.cat([p.logvar for p in parts]))

    @torch.no_grad()
    def decode(self, latents: Float[Tensor, "b d"], camera: Int[Tensor, " b"]) -> Float[Tensor, "b h w 3"]:
        """Returns the picture of each latent from its camera."""
        return self.decoder.pictures(latents, camera)
