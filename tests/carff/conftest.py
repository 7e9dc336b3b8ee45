"""A data set small enough for unit tests: two branches x two steps, four cameras on a line, 32 px."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from carff.beliefs import Belief
from carff.config import CarffConfig, EvaluationConfig
from carff.evaluation_data import EvaluationData, all_views
from carff.mixtures import GaussianMixture
from carff.model import CarffModel
from carff.nerf import LatentNerf
from carff.pcvae import Pcvae
from carff.probe import Probe, ProbeConfig, build_candidates
from carff.scene_info import SceneInfo, scene_info
from carff.state_style import state_style
from carff.states import StateTable, ambiguous_groups, build_state_table
from hashnerf.cameras import Cameras, look_at
from hashnerf.posed_images import Frame, PosedImages

SIZE, CAMERAS = 32, 4


def tiny_pictures() -> torch.Tensor:
    """A grey picture per camera; branch 1 adds a red square that moves with the step, hidden from camera 0."""
    pictures = torch.full((2, 2, CAMERAS, SIZE, SIZE, 3), 90, dtype=torch.uint8)
    for camera in range(CAMERAS):
        pictures[:, :, camera, :, : 4 + 4 * camera] = 160  # what tells the cameras apart
        for step in range(2):
            pictures[:, step, camera, 26:30, 4 + 12 * step : 12 + 12 * step] = torch.tensor([40, 60, 220])
            if camera > 0:
                pictures[1, step, camera, 8:20, 8 + 8 * step : 20 + 8 * step] = torch.tensor([230, 60, 40])
    return pictures


@pytest.fixture
def tiny_data() -> PosedImages:
    """The data set in memory, with actors, hazards, visibility and camera kinds; camera 3 is the bird's-eye view."""
    poses = [look_at((-6.0, -1.5 + camera, 2.0), (0.0, 0.0, 0.5)) for camera in range(3)]
    poses.append(look_at((0.0, 0.0, 9.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    frames = [
        Frame(f"images/b{b}_s{s}_c{c}.png", "train", b, s, c)
        for b in range(2)
        for s in range(2)
        for c in range(CAMERAS)
    ]
    pose = torch.stack([torch.as_tensor(np.asarray(poses[frame.camera])).float() for frame in frames])
    focal = torch.full((len(frames), 2), 30.0)
    cameras = Cameras(pose, focal, torch.full_like(focal, SIZE / 2), torch.zeros(len(frames), 4), SIZE, SIZE)

    def truck(step: int) -> dict:
        return {"branch": 1, "step": step, "center": [0.0, 1.0 - 2.0 * step, 0.5], "size": [1.0, 1.0, 1.0], "yaw": 0.0}

    def ego(branch: int, step: int) -> dict:
        center = [-2.0 + step, -2.0, 0.5]
        return {"branch": branch, "step": step, "center": center, "size": [0.8, 0.8, 0.8], "yaw": 0.0}

    extras = {
        "camera_kinds": ["ego", "ego", "ego", "birds_eye"],
        "branches": ["absent", "present"],
        "states": [{"branch": b, "step": s, "hazard": b == 1} for b in range(2) for s in range(2)],
        "actors": {"truck": [truck(0), truck(1)], "ego": [ego(b, s) for b in range(2) for s in range(2)]},
        "visibility": {"truck": [[1, s, c, 0 if c == 0 else 144, 144] for s in range(2) for c in range(CAMERAS)]},
    }
    box = torch.tensor([[-4.0, -4.0, 0.0], [4.0, 4.0, 3.0]])
    return PosedImages(tiny_pictures().flatten(0, 2), cameras, tuple(frames), box, extras, Path("tiny"))


@pytest.fixture
def tiny_table(tiny_data: PosedImages) -> StateTable:
    """Its states."""
    return build_state_table(tiny_data)


class KnowingMdn:
    """Forecasts the true next states: one narrow component per state, weighted as the belief weighs its predecessor."""

    def __init__(self, successor: torch.Tensor):
        self.successor = successor

    def __call__(self, mean: torch.Tensor, logvar: torch.Tensor) -> GaussianMixture:
        states = len(self.successor)
        after = torch.where(self.successor >= 0, self.successor, torch.arange(states))
        means = torch.eye(states)[after].expand(len(mean), -1, -1)
        return GaussianMixture(mean.clamp(min=1e-30).log(), means, torch.full((len(mean), states, states), -6.0))


class KnowingPcvae(Pcvae):
    """Decodes a latent to the true picture of its largest entry, 0.1 too dark."""

    def __init__(self, images: torch.Tensor, views: torch.Tensor):
        torch.nn.Module.__init__(self)
        self.register_parameter("place", torch.nn.Parameter(torch.zeros(1)))  # something that lies on the CPU
        self.images, self.views = images, views

    def decode(self, latents: torch.Tensor, camera: torch.Tensor) -> torch.Tensor:
        """Returns pictures [b, h, w, 3]."""
        return self.images[self.views[latents.argmax(dim=1), camera]].float() / 255 - 0.1


class KnowingNerf(LatentNerf):
    """Renders the true picture of a latent's largest entry, `error` too bright."""

    def __init__(self, images: torch.Tensor, views: torch.Tensor, error: float = 0.05):
        torch.nn.Module.__init__(self)
        self.register_buffer("latent_centre", torch.zeros(1))
        self.images, self.views, self.error = images, views, error

    def picture(self, latent: torch.Tensor, cameras: Cameras, index: int) -> torch.Tensor:
        """Returns a picture [h, w, 3]."""
        return self.images[self.views[latent.argmax(), index]].float() / 255 + self.error


class KnowingModel(CarffModel):
    """A model without networks: latent i stands for state i, and a view's belief is spread over the states it fits."""

    def __init__(self, config: CarffConfig, scene: SceneInfo, images: torch.Tensor, table: StateTable):
        candidates = build_candidates([list(boxes) for boxes in scene.actors], ProbeConfig(columns=(1, 1), levels=1))
        boxes = len(candidates.names)
        parts = {
            "config": config,
            "scene": scene,
            "pcvae": KnowingPcvae(images, table.views),
            "nerf": KnowingNerf(images, table.views),
            "mdn": KnowingMdn(table.successor),
            "probe": Probe(candidates, torch.ones(boxes), torch.full((boxes,), 0.5), torch.ones(boxes), 0.6),
            "state_beliefs": Belief(torch.eye(len(table)), torch.full((len(table), len(table)), -12.0)),
            "costs": {name: {"seconds": 1.5, "peak_memory_mb": 100.0} for name in ("pcvae", "nerf", "mdn")},
            "images": images,
            "table": table,
        }
        for name, value in parts.items():
            object.__setattr__(self, name, value)

    def encode(self, pictures: torch.Tensor) -> Belief:
        """Believes evenly in the states that give exactly this picture."""
        same = (pictures[:, None] == self.images[None]).flatten(2).all(dim=2).float()
        state = torch.full((len(self.images),), -1)
        shown = self.table.views >= 0
        state[self.table.views[shown]] = shown.nonzero()[:, 0]
        weight = same @ torch.nn.functional.one_hot(state, len(self.table)).float()
        mean = weight / weight.sum(dim=1, keepdim=True)
        return Belief(mean, torch.full_like(mean, -12.0))

    def probe_scores(self, latents: torch.Tensor, at_once: int = 64) -> torch.Tensor:
        """Finds each box as occupied as the latent says."""
        return latents @ self.probe.candidates.occupied.float()


@pytest.fixture
def tiny_evaluation(tiny_data: PosedImages, tmp_path: Path) -> EvaluationData:
    """A run that knows everything, beside the tiny data set with camera 2 held out, in a run folder of its own."""
    frames = tuple(replace(frame, split="test" if frame.camera == 2 else "train") for frame in tiny_data.frames)
    data = replace(tiny_data, frames=frames)
    table = build_state_table(data)
    evaluation = EvaluationConfig(images=2, trials=4, curve_samples=5, episodes=2)
    config = CarffConfig(name="known", runs=str(tmp_path), dataset="tiny", device="cpu", evaluation=evaluation)
    config.folder.mkdir()
    model = KnowingModel(config, scene_info(data, table), data.images, table)
    groups = ambiguous_groups(data.images, table.views)
    views = all_views(table, groups, model.encode(data.images))
    return EvaluationData(config, data, table, model, groups, views, state_style(table.states, table.branch_names))
