"""The mixture density network: belief about the present -> mixture of Gaussians over the next latent (CARFF Eq. 4).

Inside, everything is standardised by stored statistics (buffers, so that they travel with the weights); what comes out
is in latent units.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from carff.beliefs import Belief
from carff.mixtures import GaussianMixture, mixture_from_raw
from hashnerf.errors import UserError

# A dimension that hardly varies is not blown up: input noise of 0.01 must stay small, or it kills the ReLU units.
SMALLEST_INPUT_SCALE = 0.1
SMALLEST_TARGET_SCALE = 1e-3


class MDN(nn.Module):
    """Shared trunk, one head for the means, one for the log-sigmas; the weights come from a network of their own."""

    def __init__(
        self, latent_size: int, components: int = 2, width: int = 512, trunk_layers: int = 2, head_layers: int = 2
    ):
        super().__init__()
        sizes = {
            "latent_size": latent_size,
            "components": components,
            "width": width,
            "trunk_layers": trunk_layers,
            "head_layers": head_layers,
        }
        for name, value in sizes.items():
            if value < 1:
                raise UserError(f"mdn.{name} is {value}; give at least 1")
        self.latent_size, self.components = latent_size, components
        outputs = components * latent_size
        self.trunk = nn.Sequential(*_layers(2 * latent_size, width, trunk_layers))
        self.mean_head = nn.Sequential(*_layers(width, width, head_layers - 1), nn.Linear(width, outputs))
        self.sigma_head = nn.Sequential(*_layers(width, width, head_layers - 1), nn.Linear(width, outputs))
        self.weight_network = nn.Sequential(*_layers(2 * latent_size, width, 2), nn.Linear(width, components))
        self.register_buffer("input_centre", torch.zeros(2 * latent_size))
        self.register_buffer("input_scale", torch.ones(2 * latent_size))
        self.register_buffer("target_centre", torch.zeros(latent_size))
        self.register_buffer("target_scale", torch.ones(latent_size))

    def set_statistics(self, source: Belief, target: Belief) -> None:
        """Stores mean and spread of the beliefs that go in, and of the latents that are to come out."""
        values = torch.cat([source.mean, source.logvar], dim=1)
        self.input_centre.copy_(values.mean(dim=0))
        self.input_scale.copy_(values.std(dim=0, correction=0).clamp_min(SMALLEST_INPUT_SCALE))
        variance = target.mean.var(dim=0, correction=0) + target.logvar.exp().mean(dim=0)
        self.target_centre.copy_(target.mean.mean(dim=0))
        self.target_scale.copy_(variance.sqrt().clamp_min(SMALLEST_TARGET_SCALE))

    def forward(self, mean: Float[Tensor, "b d"], logvar: Float[Tensor, "b d"]) -> GaussianMixture:
        """Returns the mixture over the next latent for each belief, in latent units."""
        values = (torch.cat([mean, logvar], dim=1) - self.input_centre) / self.input_scale
        features = self.trunk(values)
        shape = (len(values), self.components, self.latent_size)
        mixture = mixture_from_raw(
            self.weight_network(values),
            self.mean_head(features).view(shape),
            self.sigma_head(features).view(shape),
        )
        means = mixture.means * self.target_scale + self.target_centre
        return GaussianMixture(mixture.log_weights, means, mixture.log_sigmas + self.target_scale.log())


def _layers(inputs: int, width: int, count: int) -> list[nn.Module]:
    layers: list[nn.Module] = []
    for i in range(count):
        layers += [nn.Linear(inputs if i == 0 else width, width), nn.ReLU()]
    return layers
