"""A data set small enough for unit tests: two branches x two steps, four cameras on a line, 32 px."""

from pathlib import Path

import numpy as np
import pytest
import torch

from carff.states import StateTable, build_state_table
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
        Frame(f"images/b{b}_s{s}_c{c}.png", "train", b, s, c) for b in range(2) for s in range(2) for c in range(CAMERAS)
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
