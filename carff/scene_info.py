"""What inference must know about a data set, kept with the run so that a moved run folder needs no data set."""

from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from carff.states import ActorBox, StateTable
from hashnerf.cameras import Cameras
from hashnerf.errors import UserError
from hashnerf.posed_images import PosedImages
from hashnerf.transforms_json import read_transforms, write_transforms


@dataclass(frozen=True)
class SceneInfo:
    """States, actors and cameras (one row per camera number)."""

    states: tuple[tuple[int, int], ...]
    successor: Int[Tensor, " states"]
    branch_names: tuple[str, ...]
    hazard: Bool[Tensor, " states"] | None
    actors: tuple[tuple[ActorBox, ...], ...]
    camera_kinds: tuple[str, ...]
    cameras: Cameras
    scene_box: Float[Tensor, "2 3"]
    world: dict | None = None
    """How to build the embedded world that the data set was rendered from; None for any other data set."""

    @property
    def branch(self) -> Int[Tensor, " states"]:
        """The branch of each state."""
        return torch.tensor([branch for branch, _ in self.states])

    def known_hazard(self) -> Bool[Tensor, " states"]:
        """Returns the hazard flags; raises UserError where the data set does not state them for every state."""
        if self.hazard is None:
            raise UserError(
                "transforms.json does not say which states are hazards: add `hazard` to each entry of `states`"
            )
        return self.hazard

    def cameras_of(self, kind: str) -> list[int]:
        """Returns the numbers of the cameras of a kind."""
        return [camera for camera, own in enumerate(self.camera_kinds) if own == kind]

    def save(self, path: Path) -> None:
        """Writes the information as JSON."""
        cameras = self.cameras
        plain = {
            "states": [list(state) for state in self.states],
            "successor": self.successor.tolist(),
            "branch_names": list(self.branch_names),
            "hazard": None if self.hazard is None else self.hazard.tolist(),
            "actors": [[asdict(box) for box in boxes] for boxes in self.actors],
            "camera_kinds": list(self.camera_kinds),
            "cameras": {
                "pose": cameras.pose.tolist(),
                "focal": cameras.focal.tolist(),
                "centre": cameras.centre.tolist(),
                "distortion": cameras.distortion.tolist(),
                "width": cameras.width,
                "height": cameras.height,
            },
            "scene_box": self.scene_box.tolist(),
            "world": self.world,
        }
        write_transforms(path, plain)


def scene_info(data: PosedImages, table: StateTable) -> SceneInfo:
    """Collects the information from a data set."""
    first_frame = table.views.amax(dim=0)
    return SceneInfo(
        table.states,
        table.successor,
        table.branch_names,
        table.hazard,
        table.actors,
        table.camera_kinds,
        data.cameras.select(first_frame),
        data.scene_box,
        data.extras.get("world"),
    )


def load_scene_info(path: Path) -> SceneInfo:
    """Reads what `save` wrote; raises UserError when the file is missing or not ours."""
    if not path.is_file():
        raise UserError(f"{path}: no such file; train a run first (scripts/train_pcvae.py) or give its folder")
    plain = read_transforms(path)
    try:
        camera = plain["cameras"]
        tensors = {key: torch.tensor(camera[key]) for key in ("pose", "focal", "centre", "distortion")}
        return SceneInfo(
            tuple((branch, step) for branch, step in plain["states"]),
            torch.tensor(plain["successor"]),
            tuple(plain["branch_names"]),
            None if plain["hazard"] is None else torch.tensor(plain["hazard"]),
            tuple(tuple(_box(entry) for entry in boxes) for boxes in plain["actors"]),
            tuple(plain["camera_kinds"]),
            Cameras(**tensors, width=camera["width"], height=camera["height"]),
            torch.tensor(plain["scene_box"]),
            plain["world"],
        )
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path}: not written by a training run ({error}); train the run again") from error


def _box(entry: dict) -> ActorBox:
    return ActorBox(entry["name"], tuple(entry["center"]), tuple(entry["size"]), entry["yaw"])
