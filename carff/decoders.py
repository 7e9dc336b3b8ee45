"""Picture decoders of the PC-VAE: a latent and a target camera in, a picture out (CARFF 3.1: p(I | z, c'')).

Both decoders answer three questions: `reconstruction_errors` (training: squared error averaged over the pixels of the
target pictures), `pixel_errors` (the plain error to one state's pictures) and `pictures` (looking: float pictures
in [0, 1]). `camera` is the row of a camera in the data set. Training targets are the mean pictures of the states that a
latent may stand for, weighted by `chance` [b, states]: where no view is missing, the squared error to the mean and the
expected squared error to the states differ by a constant.

* `components`: every camera's picture is its mean picture plus a few principal components of what changes there
  between the states; a small network gives the coefficients from the latent. Because the components are orthonormal,
  the pixel loss is a loss between coefficients, so every camera of every encoded picture is decoded at every step.
* `conv`: transposed convolutions from the latent and the camera, which is one-hot (the paper) or a pose (position and
  axes, so that cameras never trained on can be decoded).
"""

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor, nn

from hashnerf.errors import UserError
from hashnerf.low_precision import without_autocast

SMALLEST_COMPONENT = 1e-4  # of a camera's largest, or of one pixel from black to white: far below one grey level


@dataclass(frozen=True)
class DecoderConfig:
    """What turns a latent and a camera into a picture."""

    kind: Literal["components", "conv"] = "components"
    """`components`: per-camera principal components; `conv`: transposed convolutions (the paper)."""
    components: int = 16
    """Largest number of principal components per camera; never more than the states allow."""
    camera: Literal["one_hot", "pose"] = "one_hot"
    """How `conv` is told the camera: `one_hot` as in the paper, or its `pose`, which also works for unseen cameras."""
    width: int = 256
    """Hidden units of `components`, or channels of the first feature map of `conv`."""
    targets: int = 2
    """Target cameras decoded per encoded picture and step by `conv`."""
    balance: float = 1.0
    """How far `components` weighs small changes like large ones: 0 is the plain pixel error, 1 counts components
    alike, whatever share of the picture they change."""

    def __post_init__(self):
        for key in ("components", "width", "targets"):
            if getattr(self, key) < 1:
                raise UserError(f"decoder.{key} is {getattr(self, key)}; give at least 1")
        if not 0 <= self.balance <= 1:
            raise UserError(f"decoder.balance is {self.balance}; give a value from 0 to 1")


class ComponentsDecoder(nn.Module):
    """Mean picture and principal components per camera; a network from the latent to the coefficients."""

    def __init__(self, config: DecoderConfig, latent_size: int, cameras: int, states: int, height: int, width: int):
        super().__init__()
        self.rank = min(config.components, max(states - 1, 1))
        self.balance = config.balance
        self.picture_shape = (height, width, 3)
        pixels = height * width * 3
        self.register_buffer("mean", torch.zeros(cameras, pixels))
        # Half precision: orthonormal directions need no more, and a hundred cameras of them fill the checkpoint.
        self.register_buffer("basis", torch.zeros(cameras, self.rank, pixels, dtype=torch.float16))
        self.register_buffer("scale", torch.ones(cameras, self.rank))
        self.network = nn.Sequential(
            nn.Linear(latent_size, config.width),
            nn.ReLU(),
            nn.Linear(config.width, config.width),
            nn.ReLU(),
            nn.Linear(config.width, cameras * self.rank),
        )

    @torch.no_grad()
    @without_autocast
    def fit_basis(self, pictures: UInt8[Tensor, "n h w 3"], view_index: Int[Tensor, "states cameras"]) -> None:
        """Computes each camera's mean and principal components; `view_index` holds picture rows, -1 where missing."""
        targets = torch.zeros(*view_index.shape, self.rank)
        self.unreached = torch.zeros(view_index.shape)  # squared error that no coefficients can mend
        for camera in range(view_index.shape[1]):
            present = (view_index[:, camera] >= 0).nonzero()[:, 0]
            if len(present) == 0:
                continue
            rows = pictures[view_index[present, camera]].flatten(1).float() / 255.0
            mean = rows.mean(dim=0)
            self.mean[camera] = mean
            centred = rows - mean
            # The states are few and the pixels many: the small Gram matrix has the same eigenvalues.
            _, left = torch.linalg.eigh((centred @ centred.T).double())
            basis = left.flip(1)[:, : self.rank].T.float() @ centred
            # Equal pictures leave directions of rounding errors, which normalised would look like components.
            size = basis.norm(dim=-1, keepdim=True)
            basis = torch.where(size > SMALLEST_COMPONENT * size.max().clamp(min=1.0), basis / size, 0.0)
            rank = len(basis)
            self.basis[camera, :rank] = basis.half()
            targets[present, camera, :rank] = centred @ basis.T
            left_over = centred.square().sum(dim=1) - targets[present, camera].square().sum(dim=1)
            self.unreached[present, camera] = left_over.clamp(min=0)
        self.scale.copy_(targets.square().mean(dim=0).sqrt().clamp(min=1e-3))
        self.targets = targets
        self.target_valid = (view_index >= 0).float()
        self.weight = self._component_weight(targets)

    def _component_weight(self, targets: Float[Tensor, "states cameras rank"]) -> Float[Tensor, "cameras rank"]:
        """Returns the weight of each component's squared error, 1 on average over what changes.

        A car right in front of a camera changes a hundred times more pixels than a truck far away; by the plain error
        the latent learns where the car stands and ignores whether there is a truck.
        """
        energy = targets.square().mean(dim=0)
        if not energy.any():
            return torch.ones_like(energy)
        weight = (energy + 0.1 * energy[energy > 0].median()) ** -self.balance * (energy > 0)
        return weight * energy.sum() / (weight * energy).sum()

    def coefficients(self, latents: Float[Tensor, "b d"]) -> Float[Tensor, "b cameras rank"]:
        """Returns every camera's coefficients."""
        return self.network(latents).unflatten(-1, self.scale.shape) * self.scale

    def reconstruction_errors(
        self, latents: Float[Tensor, "b d"], chance: Float[Tensor, "b states"], generator: torch.Generator
    ) -> Float[Tensor, " b"]:
        """Returns each latent's pixel-mean squared error over all target cameras, components weighted by `balance`.

        The part of the pictures that no component reaches is left out: no latent can change it.
        """
        del generator  # every camera is a target: nothing to draw
        valid = self.target_valid.to(latents.device)
        known = chance @ valid
        target = torch.einsum("bs,scr->bcr", chance, self.targets.to(latents.device) * valid[:, :, None])
        target = target / known.clamp(min=1e-12)[:, :, None]
        squared = ((self.coefficients(latents) - target).square() * self.weight.to(latents.device)).sum(dim=-1)
        return (squared * known).sum(dim=1) / known.sum(dim=1).clamp(min=1e-12) / self.mean.shape[1]

    def pixel_errors(
        self, latents: Float[Tensor, "b d"], state: Int[Tensor, " b"], generator: torch.Generator
    ) -> Float[Tensor, " b"]:
        """Returns each latent's plain pixel-mean squared error to the pictures of a state, over all its cameras."""
        del generator
        state = state.to(self.targets.device)
        squared = (self.coefficients(latents).to(self.targets.device) - self.targets[state]).square().sum(dim=-1)
        valid = self.target_valid[state]
        return ((squared + self.unreached[state]) * valid).sum(dim=1) / valid.sum(dim=1) / self.mean.shape[1]

    def pictures(self, latents: Float[Tensor, "b d"], camera: Int[Tensor, " b"]) -> Float[Tensor, "b h w 3"]:
        """Returns the picture of each latent from its camera."""
        own = self.coefficients(latents)[torch.arange(len(camera)), camera]
        flat = self.mean[camera] + torch.einsum("br,brp->bp", own, self.basis[camera].float())
        return flat.clamp(0, 1).unflatten(-1, self.picture_shape)


class ConvDecoder(nn.Module):
    """Transposed convolutions from latent and camera (CARFF B.1, with a sigmoid for [0, 1] targets)."""

    def __init__(self, config: DecoderConfig, latent_size: int, camera_code: Float[Tensor, "cameras code"], size: int):
        super().__init__()
        if size & (size - 1) or size < 8:
            raise UserError(f"the conv decoder needs square pictures whose side is a power of two, not {size}")
        self.targets_per_picture = config.targets
        self.register_buffer("camera_code", camera_code.float())
        channels = config.width
        self.start = nn.Linear(latent_size + camera_code.shape[1], channels * 16)
        layers: list[nn.Module] = []
        side = 4
        while side < size:
            narrower = max(channels // 2, 16)
            layers += [nn.ConvTranspose2d(channels, narrower, 4, 2, 1), nn.GroupNorm(8, narrower), nn.ReLU()]
            channels, side = narrower, side * 2
        self.network = nn.Sequential(*layers, nn.Conv2d(channels, 3, 3, 1, 1))
        # A camera's mean picture is the best guess that needs no latent; the network paints what differs from it.
        self.register_buffer("mean", torch.zeros(len(camera_code), 3, size, size))
        self.paint_mean = config.camera == "one_hot"

    @torch.no_grad()
    def fit_basis(self, pictures: UInt8[Tensor, "n h w 3"], view_index: Int[Tensor, "states cameras"]) -> None:
        """Stores the training pictures' index and, for one-hot cameras, each camera's mean picture."""
        self.training_pictures = pictures
        self.view_index = view_index
        if self.paint_mean:
            for camera in range(view_index.shape[1]):
                rows = view_index[:, camera]
                rows = rows[rows >= 0]
                if len(rows):
                    self.mean[camera] = pictures[rows].float().mean(dim=0).permute(2, 0, 1) / 255.0

    def decode(self, latents: Float[Tensor, "b d"], camera: Int[Tensor, " b"]) -> Float[Tensor, "b 3 h w"]:
        """Returns pictures in (0, 1)."""
        x = self.start(torch.cat([latents, self.camera_code[camera]], dim=-1)).unflatten(-1, (-1, 4, 4))
        raw = self.network(x)
        if self.paint_mean:
            return torch.sigmoid(raw + torch.logit(self.mean[camera], eps=0.02))
        return torch.sigmoid(raw)

    def reconstruction_errors(
        self, latents: Float[Tensor, "b d"], chance: Float[Tensor, "b states"], generator: torch.Generator
    ) -> Float[Tensor, " b"]:
        """Returns each latent's mean squared error over the pixels of randomly drawn target cameras."""
        chance = chance.repeat_interleave(self.targets_per_picture, dim=0).cpu()
        known = chance @ (self.view_index >= 0).float()
        camera = torch.multinomial(known, 1, generator=generator)[:, 0]
        frames = self.view_index[:, camera].T
        share = chance * (frames >= 0) / known.gather(1, camera[:, None])
        row, state = share.nonzero(as_tuple=True)
        parts = self.training_pictures[frames[row, state]].float() * share[row, state, None, None, None] / 255.0
        target = torch.zeros(len(camera), *parts.shape[1:]).index_add_(0, row, parts).to(latents.device)
        shown = self.decode(latents.repeat_interleave(self.targets_per_picture, dim=0), camera.to(latents.device))
        squared = (shown - target.permute(0, 3, 1, 2)).square().mean(dim=(1, 2, 3))
        return squared.unflatten(0, (-1, self.targets_per_picture)).mean(dim=1)

    def pixel_errors(
        self, latents: Float[Tensor, "b d"], state: Int[Tensor, " b"], generator: torch.Generator
    ) -> Float[Tensor, " b"]:
        """Returns each latent's mean squared error to the pictures of a state, from randomly drawn cameras."""
        chance = nn.functional.one_hot(state, len(self.view_index)).float()
        return self.reconstruction_errors(latents, chance, generator)

    def pictures(self, latents: Float[Tensor, "b d"], camera: Int[Tensor, " b"]) -> Float[Tensor, "b h w 3"]:
        """Returns the picture of each latent from its camera."""
        return self.decode(latents, camera).permute(0, 2, 3, 1)


def pose_code(poses: Float[Tensor, "cameras 4 4"], scene_box: Float[Tensor, "2 3"]) -> Float[Tensor, "cameras 12"]:
    """Returns position in units of half the scene box, and the three camera axes."""
    centre, half = scene_box.mean(dim=0), (scene_box[1] - scene_box[0]) / 2
    return torch.cat([(poses[:, :3, 3] - centre) / half.max(), poses[:, :3, :3].flatten(1)], dim=-1)
