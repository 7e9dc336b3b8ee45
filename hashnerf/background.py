"""What lies beyond the scene box: colour by direction, or a flat ground coloured by place below a sky.

By direction alone the horizon is as soft as the spherical harmonics are, and a ground that goes on beyond the box has
no colour that fits two places of the camera. What the background cannot show, training builds as a painted wall just
inside the box, and a camera near the ground sees that wall. With `ground` a ray that leaves the box downwards takes
the colour of the place where it meets the plane that the box stands on; places are contracted as in mip-NeRF 360
(Barron et al., 2022, equation 10), in the largest norm, so that the plane has no end. Under the box no place has a
colour of its own: what stands there is the field's to show.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from hashnerf.rays import Rays
from hashnerf.spherical_harmonics import spherical_harmonics

PLACES = 64
"""Places along each side of the ground's picture; the middle half of each side is the box, and stays unused."""


class Background(nn.Module):
    """Colour beyond a box (metres) as a function of a ray and, optionally, a condition."""

    def __init__(
        self,
        box: Float[Tensor, "2 3"],
        direction_degree: int,
        condition_size: int,
        ground: bool,
        sky_width: int = 0,
    ):
        super().__init__()
        self.direction_degree = direction_degree
        inputs = direction_degree**2 + condition_size
        last = nn.Linear(sky_width or inputs, 3)
        # a sky that no picture shows stays grey instead of taking some colour by chance
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.sky = nn.Sequential(nn.Linear(inputs, sky_width), nn.ReLU(), last) if sky_width else last
        self.ground = nn.Linear(inputs, 3) if ground else None
        if ground:
            self.register_buffer("box", box.clone(), persistent=False)
            self.picture = nn.Parameter(torch.zeros(1, 3, PLACES, PLACES))

    def forward(self, rays: Rays, condition: list[Tensor]) -> Float[Tensor, "rays 3"]:
        """Returns colours in [0, 1]; `condition` holds one column block per ray, or nothing."""
        columns = torch.cat([spherical_harmonics(rays.directions, self.direction_degree), *condition], dim=1)
        with torch.autocast(rays.directions.device.type, enabled=False):
            sky = self.sky(columns)
            if self.ground is None:
                return torch.sigmoid(sky)
            down = rays.directions[:, 2:] < 0
            return torch.sigmoid(torch.where(down, self.ground(columns) + self._painted(self.places(rays)), sky))

    def places(self, rays: Rays) -> Float[Tensor, "rays 2"]:
        """Returns where rays meet the plane that the box stands on, contracted: up to 1/2 the box, at 1 infinity.

        Only rays that go down have one; the others get the farthest place ahead of them.
        """
        centre, half = self.box.mean(dim=0)[:2], (self.box[1] - self.box[0])[:2] / 2
        height = (rays.origins[:, 2:] - self.box[0, 2]).clamp(min=0)
        fall = (-rays.directions[:, 2:]).clamp(min=1e-4)  # flatter than this is the horizon
        place = (rays.origins[:, :2] + rays.directions[:, :2] * height / fall - centre) / half
        far = place.abs().amax(dim=1, keepdim=True).clamp(min=1.0)
        return place / far * (2 - 1 / far) / 2

    def _painted(self, places: Tensor) -> Tensor:
        found = nn.functional.grid_sample(self.picture, places[None, None], align_corners=True)[0, :, 0].T
        return found * (places.abs().amax(dim=1, keepdim=True) > 0.5)
