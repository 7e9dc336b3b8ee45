"""Pictures of a flat, mottled ground, exact up to interpolation, for tests of tracking and alignment."""

import cv2
import numpy as np
import torch

from hashnerf.cameras import Cameras, image_rays, look_at
from hashnerf.posed_images import Frame, PosedImages

PIXEL, SIDE = 0.01, 400
BOX = torch.tensor([[0.0, 0.0, 0.0], [PIXEL * SIDE, PIXEL * SIDE, 1.0]])


def texture() -> np.ndarray:
    """Grey levels of the ground, square (row, column) = (y, x) of `PIXEL` metres: blobs of 3 to 10 cm."""
    rng = np.random.default_rng(0)
    layers = [cv2.GaussianBlur(rng.standard_normal((SIDE, SIDE)), (0, 0), size) * size for size in (3.0, 6.0, 10.0)]
    total = sum(layers)
    return (127 + 50 * total / total.std()).clip(0, 255).astype(np.float32)


def cameras(poses: torch.Tensor, width: int = 160, height: int = 120) -> Cameras:
    """A slightly distorted lens at poses."""
    count = len(poses)
    lens = torch.tensor([[-0.08, 0.012, 0.001, -0.001]]).repeat(count, 1)
    centre = torch.tensor([[width / 2 + 1.5, height / 2 - 2.0]]).repeat(count, 1)
    return Cameras(poses, torch.full((count, 2), 0.75 * width), centre, lens, width, height)


def flight(count: int = 12) -> torch.Tensor:
    """Poses 1.6 m above the ground, half straight down, half oblique, over the middle of it."""
    rng = np.random.default_rng(1)
    poses = []
    for number in range(count):
        eye = np.array([*rng.uniform(1.2, 2.8, 2), rng.uniform(1.5, 1.8)])
        aside = np.array([*rng.uniform(-0.1, 0.1, 2), 0.0]) if number % 2 else np.array([*rng.uniform(-0.8, 0.8, 2), 0])
        poses.append(look_at(eye.tolist(), (eye * [1, 1, 0] + aside).tolist(), (0, 1, 0)))
    return torch.stack(poses)


def photograph(seen: Cameras, index: int, height: float = 0.0) -> np.ndarray:
    """What a camera sees of the ground at z = `height`, rgb."""
    rays = image_rays(seen, index)
    length = (height - rays.origins[:, 2]) / rays.directions[:, 2]
    places = (rays.origins + rays.directions * length[:, None])[:, :2].numpy() / PIXEL - 0.5
    x, y = places.astype(np.float32).reshape(seen.height, seen.width, 2).transpose(2, 0, 1)
    grey = cv2.remap(texture(), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return np.repeat(grey.round().astype(np.uint8)[..., None], 3, axis=2)


def survey(poses: torch.Tensor, told: torch.Tensor, tmp_path, height: float = 0.0) -> PosedImages:
    """A data set photographed from `poses` that tells others."""
    true = cameras(poses)
    pictures = torch.from_numpy(np.stack([photograph(true, index, height) for index in range(len(poses))]))
    frames = tuple(Frame(f"images/{n:02d}.png", "train", 0, 0, n) for n in range(len(poses)))
    return PosedImages(pictures, cameras(told), frames, BOX, {}, tmp_path)
