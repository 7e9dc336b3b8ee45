"""Training rays by state: pixels of the views of a state, half of them where the states of a camera differ.

Most of a picture is the same in every state (about 31 dB of PSNR comes from a camera's mean picture alone), so uniform
pixels spend the radiance field's time on what it already knows. A `changed` pixel is one whose colour differs between
two states of its camera by more than a threshold.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from hashnerf.cameras import Cameras, camera_rays
from hashnerf.rays import Rays


def changed_mask(pictures: UInt8[Tensor, "states h w 3"], threshold: int = 12) -> Tensor:
    """Returns [h, w] bool: the pixels where two of the pictures differ by more than `threshold` levels."""
    spread = pictures.amax(dim=0).int() - pictures.amin(dim=0).int()
    return spread.amax(dim=-1) > threshold


@dataclass(frozen=True)
class StateRays:
    """Pixels of all training views, by state and camera."""

    pictures: UInt8[Tensor, "frames h w 3"]
    cameras: Cameras
    view_index: Int[Tensor, "states cams"]
    changed: Int[Tensor, "changes 3"]
    """Row, column and camera of every changed pixel."""
    new: Int[Tensor, " new"]
    """Cameras that an earlier training has not seen."""

    def draw(
        self, states: Int[Tensor, " rays"], changed_share: float, generator: torch.Generator, new_share: float = 0.0
    ) -> tuple[Rays, Float[Tensor, "rays 3"]]:
        """Draws one pixel per requested state and returns its ray and colour in [0, 1].

        `changed_share` of them are changed pixels; of the others `new_share` belong to new cameras.
        """
        count = len(states)
        height, width = self.pictures.shape[1:3]
        present = self.view_index >= 0
        # present cameras first: a random place among them is far cheaper than a weighted draw over all
        cameras = present.int().argsort(dim=1, descending=True, stable=True)
        number = present.sum(dim=1)[states]
        place = (torch.rand(count, generator=generator) * number).long().minimum(number - 1)
        camera = cameras[states, place]
        if len(self.new) and new_share > 0:
            pick = self.new[torch.randint(len(self.new), (count,), generator=generator)]
            use = (torch.rand(count, generator=generator) < new_share) & present[states, pick]
            camera = torch.where(use, pick, camera)
        row = torch.randint(height, (count,), generator=generator)
        column = torch.randint(width, (count,), generator=generator)
        if len(self.changed) and changed_share > 0:
            pick = torch.randint(len(self.changed), (count,), generator=generator)
            use = torch.rand(count, generator=generator) < changed_share
            use &= self.view_index[states, self.changed[pick, 2]] >= 0
            row = torch.where(use, self.changed[pick, 0], row)
            column = torch.where(use, self.changed[pick, 1], column)
            camera = torch.where(use, self.changed[pick, 2], camera)
        frame = self.view_index[states, camera]
        colour = self.pictures[frame, row, column].float() / 255.0
        pixel = torch.stack([column, row], dim=-1).float() + 0.5
        return camera_rays(self.cameras, frame, pixel), colour


def build_state_rays(
    pictures: UInt8[Tensor, "frames h w 3"],
    cameras: Cameras,
    view_index: Int[Tensor, "states cams"],
    known: Int[Tensor, "states cams"] | None = None,
) -> StateRays:
    """Collects the changed pixels of every camera; `view_index` holds frame rows, -1 where a view is missing.

    `known` holds the views that an earlier training has seen; cameras without any there are new.
    """
    parts = []
    for camera in range(view_index.shape[1]):
        frames = view_index[:, camera]
        frames = frames[frames >= 0]
        if len(frames) < 2:
            continue
        where = changed_mask(pictures[frames]).nonzero()
        parts.append(torch.cat([where, torch.full((len(where), 1), camera)], dim=1))
    changed = torch.cat(parts) if parts else torch.zeros(0, 3, dtype=torch.int64)
    is_new = torch.zeros(view_index.shape[1], dtype=torch.bool)
    if known is not None:
        is_new = (view_index >= 0).any(dim=0) & ~(known >= 0).any(dim=0)
    return StateRays(pictures, cameras, view_index, changed, is_new.nonzero()[:, 0])
