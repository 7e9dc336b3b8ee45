"""How good the radiance field is: held-out drone pictures, corrected poses, and views from the ground.

Test pictures have poses with noise of their own, which no training can correct. They are judged twice: as told, and
after their poses were aligned to the field by the photometric error alone (as BARF and others do).
"""

import json
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from aerial2ground.car_camera import CarCameraConfig, car_cameras
from aerial2ground.config import AerialConfig
from aerial2ground.ground_truth import axis_depth, true_views, view_errors
from aerial2ground.pose_refinement import PoseCorrections, pose_errors
from aerial2ground.reconstruction import RoadNerf
from aerial2ground.stages import load_nerf, load_survey
from hashnerf.cameras import Cameras
from hashnerf.errors import UserError
from hashnerf.finite_steps import FiniteSteps
from hashnerf.fit import RayBatch, render_batch
from hashnerf.metrics import psnr
from hashnerf.model_files import weights_digest
from hashnerf.picture_rays import PictureRays
from hashnerf.posed_images import PosedImages
from hashnerf.static_scene import one_colour_psnr
from hashnerf.transforms_json import read_transforms, write_atomically
from worlds.scenarios import world_from_description
from worlds.scene import World

ALIGN_STEPS, ALIGN_RAYS, ALIGN_RATE = 120, 2048, 0.003
GROUND_VIEWS = 12
"""Views from the ground per trajectory."""


def evaluate_run(config: AerialConfig, aerial: bool = True) -> dict:
    """Measures a run's radiance field and writes reconstruction.json; returns what it wrote.

    `aerial` asks for the held-out pictures, which take most of the time, with survey.png and aerial_view.png (held out
    above, rendered from the aligned pose below). With an embedded world behind the data set also the poses and the
    views from the ground, and ground_views.png: the truth above, the view of the field below.
    """
    survey = load_survey(config)
    nerf, cost = load_nerf(config, survey)
    test, train, folder = survey.test, survey.train, Path(config.dataset)
    results: dict = {"seconds": cost["seconds"], "test_pictures": len(test)}
    results["weights"] = weights_digest(config.folder / "reconstruction")
    if not aerial:
        results |= _measured_before(config.folder / "reconstruction.json", results["weights"])
    if len(test) and aerial:
        aligned = aligned_poses(nerf, test, config.seed)
        results["aerial_psnr_db"] = aerial_psnr(nerf, test, test.cameras.pose)
        results["aerial_psnr_aligned_db"] = aerial_psnr(nerf, test, aligned)
        save_aerial_pictures(nerf, train, test, aligned, config.folder)
        results["aerial_psnr_one_colour_db"] = one_colour_psnr(train, test)
    if (folder / "truth.json").is_file():
        results["poses"] = refined_pose_errors(nerf, train, true_poses(folder, train))
    if survey.data.extras.get("world") is not None and not survey.data.origin.any():
        world = world_from_description(survey.data.extras["world"])
        shares = np.arange(GROUND_VIEWS) / GROUND_VIEWS
        places = [path.poses(shares * path.length) for path in survey.trajectories.values()]
        results["ground"], pairs = ground_errors(nerf, world, config.camera, np.concatenate(places), train.cameras)
        results["view_ms"] = view_milliseconds(nerf, car_cameras(config.camera, torch.from_numpy(places[0])))
        rows = [pairs[start::GROUND_VIEWS] for start in range(0, GROUND_VIEWS, max(GROUND_VIEWS // 3, 1))]
        strips = [np.concatenate([np.concatenate(pair) for pair in row], axis=1) for row in rows]
        Image.fromarray(np.concatenate(strips)).save(config.folder / "ground_views.png")
    write_atomically(config.folder / "reconstruction.json", json.dumps(results, indent=1, allow_nan=False).encode())
    return results


def _measured_before(path: Path, weights: str) -> dict:
    """Returns what an earlier call found of the same field's held-out pictures, or why that is missing."""
    before = read_transforms(path) if path.is_file() else {}
    if before.get("weights") == weights:
        return {key: value for key, value in before.items() if key.startswith("aerial_") or key == "not_run"}
    return {"not_run": {"nerf.aerial_heldout_psnr_db": "held-out pictures were not asked for (--aerial false)"}}


def save_aerial_pictures(
    nerf: RoadNerf, train: PosedImages, test: PosedImages, aligned: Float[Tensor, "n 4 4"], folder: Path
) -> None:
    """Writes survey.png, eight of the training pictures, and aerial_view.png, held-out pictures above renderings."""
    chosen = train.images[np.linspace(0, len(train) - 1, 8).round()].numpy()
    rows = [np.concatenate(list(half), axis=1) for half in (chosen[:4], chosen[4:])]
    Image.fromarray(np.concatenate(rows)).save(folder / "survey.png")
    cameras, pairs = replace(test.cameras, pose=aligned), []
    for index in np.unique(np.linspace(0, len(test) - 1, 3).round().astype(int)):
        seen = nerf.view(cameras, int(index)).rgb.view(test.images[index].shape)
        pairs.append(np.concatenate([test.images[index].numpy(), (seen * 255).round().to(torch.uint8).numpy()]))
    Image.fromarray(np.concatenate(pairs, axis=1)).save(folder / "aerial_view.png")


def aerial_psnr(nerf: RoadNerf, data: PosedImages, poses: Float[Tensor, "n 4 4"]) -> float:
    """Returns the mean PSNR (dB) of pictures rendered from `poses`."""
    cameras = replace(data.cameras, pose=poses)
    values = []
    for index, picture in enumerate(data.images):
        seen = nerf.view(cameras, index).rgb.view(picture.shape)
        values.append(psnr(seen, picture.float() / 255))
    return float(np.mean(values))


def aligned_poses(nerf: RoadNerf, data: PosedImages, seed: int = 0) -> Float[Tensor, "n 4 4"]:
    """Returns poses whose pictures agree best with the frozen field, found from the told ones."""
    corrections = PoseCorrections(len(data.images), fixed_gauge=False)
    optimizer = torch.optim.Adam(corrections.parameters(), lr=ALIGN_RATE)
    pictures, guard = PictureRays.of(data), FiniteSteps()
    for parameter in nerf.parameters():
        parameter.requires_grad_(False)
    for step in range(ALIGN_STEPS):
        generator = torch.Generator().manual_seed(seed * 100_003 + step)
        number, pixel = pictures.draw(ALIGN_RAYS, generator)
        rays, colour = pictures.rays(number, pixel, corrections)
        optimizer.param_groups[0]["lr"] = ALIGN_RATE * (1 - step / ALIGN_STEPS)
        optimizer.zero_grad()
        seen = render_batch(nerf.field, RayBatch(rays, colour), nerf.occupancy, nerf.config.march, generator)
        error = torch.nn.functional.huber_loss(seen.rgb, colour, delta=0.1)
        error.backward()
        slope = torch.nn.utils.get_total_norm([p.grad for p in corrections.parameters() if p.grad is not None])
        if guard.accepts(step, {"colour loss": error.detach(), "gradient": slope}):
            optimizer.step()
    for parameter in nerf.parameters():
        parameter.requires_grad_(True)
    with torch.no_grad():
        return corrections(data.cameras.pose, torch.arange(len(data.images)))


def refined_pose_errors(nerf: RoadNerf, data: PosedImages, truth: Float[Tensor, "n 4 4"]) -> dict:
    """Returns the root mean square errors of told and corrected training poses, metres and degrees."""
    with torch.no_grad():
        refined = nerf.corrections(data.cameras.pose, torch.arange(len(truth)))
    results = {}
    for name, poses in (("told", data.cameras.pose), ("refined", refined)):
        metres, radians = pose_errors(poses, truth)
        results[f"{name}_m"] = float(metres.square().mean().sqrt())
        results[f"{name}_deg"] = float(torch.rad2deg(radians.square().mean().sqrt()))
    return results


def ground_errors(
    nerf: RoadNerf, world: World, camera: CarCameraConfig, poses: Float[np.ndarray, "n 3"], above: Cameras | None = None
) -> tuple[dict, list[tuple[np.ndarray, np.ndarray]]]:
    """Returns how far views from the ground are from the truth, and (truth, rendered) pictures beside each other."""
    cameras = car_cameras(camera, torch.from_numpy(poses))
    truth = true_views(world, cameras, above)
    colours, depths, pairs = [], [], []
    for index, true in enumerate(truth):
        seen = nerf.view(cameras, index)
        colour = seen.rgb.view(true.rgb.shape)
        colours.append(colour)
        depths.append(axis_depth(cameras, index, seen.median_depth))
        pairs.append((true.rgb.numpy(), (colour * 255).round().to(torch.uint8).numpy()))
    return asdict(view_errors(truth, colours, depths)), pairs


def view_milliseconds(nerf: RoadNerf, cameras: Cameras, clock: Callable[[], float] = time.perf_counter) -> float:
    """Returns the median wall-clock time of rendering one camera's view; the first view is not counted."""
    times = []
    for index in range(len(cameras)):
        start = clock()
        nerf.view(cameras, index)
        times.append(1000 * (clock() - start))
    return statistics.median(times[1:] or times)


def true_poses(folder: Path, data: PosedImages) -> Float[Tensor, "n 4 4"]:
    """Returns the true poses of the pictures of an embedded world's survey, in the order of `data`."""
    path = folder / "truth.json"
    try:
        poses = torch.tensor(read_transforms(path)["poses"], dtype=torch.float32).reshape(-1, 4, 4)
        rows = poses[[frame.camera for frame in data.frames]].clone()
    except (KeyError, TypeError, ValueError, IndexError, RuntimeError) as error:
        raise UserError(f"{path}: does not hold a 4 x 4 pose of every camera; make the data set again") from error
    rows[:, :3, 3] -= data.origin.float()
    return rows
