"""Forecast from a picture file, written as forecast.json and pictures of the sampled futures."""

import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import cv2
import torch
from jaxtyping import UInt8
from torch import Tensor

from carff.decisions import decide_from_pictures
from carff.model import CarffModel
from carff.probe import UNKNOWN
from hashnerf.errors import UserError
from hashnerf.image_files import read_rgb, write_png
from hashnerf.progress import say
from hashnerf.transforms_json import write_atomically


@dataclass(frozen=True)
class ForecastResult:
    """Lines to print, and everything that forecast.json holds."""

    summary: tuple[str, ...]
    document: dict


def forecast_image(
    model: CarffModel, image: Path, out: Path, samples: int, ahead: int, camera: int, seed: int
) -> ForecastResult:
    """Forecasts from a picture file and writes the result into `out`; UserError for an unusable file or number."""
    if samples < 1 or ahead < 1:
        raise UserError(f"samples = {samples} and ahead = {ahead}: give at least 1 of each")
    cameras = model.scene.cameras
    if not -1 <= camera < len(cameras):
        raise UserError(f"camera = {camera}: the run has cameras 0 to {len(cameras) - 1}")
    picture = read_picture(image, cameras.width, cameras.height)
    belief = model.encode(picture[None])
    forecast = model.forecast(belief, samples, ahead, torch.Generator().manual_seed(seed))
    views = viewpoints(model, camera)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise UserError(f"{out}: is a file; give a folder for the forecast") from error
    for sample, latent in enumerate(forecast.latents[-1]):
        for name, number in views.items():
            seen = model.nerf.picture(latent, cameras, number)
            write_png(out / f"sample{sample:02d}_{name}.png", (seen * 255).round().byte().numpy())
    document = {
        "image": str(image),
        "seed": seed,
        "belief": {"mean": belief.mean[0].tolist(), "logvar": belief.logvar[0].tolist()},
        "mixture_weights": forecast.mixture.log_weights[0].exp().tolist(),
        "steps": [_step(model, states) for states in forecast.states],
    }
    if model.scene.hazard is not None:
        # by the same path as in the evaluation; driving adds what earlier pictures rule out
        generator = torch.Generator().manual_seed(seed)
        decision = decide_from_pictures(model, picture[None], model.config.planner, samples, generator)[0]
        document["decision"] = {"go": decision.go, "hazard_probability": decision.hazard_probability}
    write_atomically(out / "forecast.json", json.dumps(document, indent=1, allow_nan=False).encode())
    return ForecastResult(tuple(_lines(document, out)), document)


def read_picture(path: Path, width: int, height: int) -> UInt8[Tensor, "h w 3"]:
    """Reads a picture and brings it to the size the model was trained on (same aspect ratio required)."""
    picture = read_rgb(path)
    if picture.shape[1] * height != picture.shape[0] * width:
        raise UserError(
            f"{path}: is {picture.shape[1]} x {picture.shape[0]} pixels; crop it to the aspect ratio {width} : {height}"
        )
    if picture.shape[1] < width:
        say(
            f"{path}: {picture.shape[1]} pixels wide, enlarged to {width}; the forecast may miss small things, "
            f"give a picture of at least {width} pixels."
        )
    if picture.shape[1] != width:
        picture = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    return torch.as_tensor(picture)


def viewpoints(model: CarffModel, camera: int) -> dict[str, int]:
    """Returns the cameras to render from: the bird's-eye camera if there is one, and an ego camera."""
    scene = model.scene
    views = {kind: scene.cameras_of(kind)[0] for kind in ("birds_eye", "ego") if scene.cameras_of(kind)}
    if camera >= 0:
        views["camera"] = camera
    return views or {"camera": 0}


def _step(model: CarffModel, states: Tensor) -> dict:
    counts = Counter(states.tolist())
    rows = []
    for state, count in counts.most_common():
        if state == UNKNOWN:
            rows.append({"state": None, "name": "unknown", "share": count / len(states)})
            continue
        branch, step = model.scene.states[state]
        name = f"{model.scene.branch_names[branch]}, step {step}"
        rows.append({"state": [branch, step], "name": name, "share": count / len(states)})
    return {"states": rows}


def _lines(document: dict, out: Path) -> list[str]:
    lines = [f"mixture weights: {', '.join(f'{weight:.2f}' for weight in document['mixture_weights'])}"]
    for ahead, step in enumerate(document["steps"], start=1):
        shares = "; ".join(f"{row['name']}: {row['share']:.0%}" for row in step["states"])
        lines.append(f"{ahead} step ahead: {shares}" if ahead == 1 else f"{ahead} steps ahead: {shares}")
    if "decision" in document:
        decision = document["decision"]
        word = "go" if decision["go"] else "stop"
        lines.append(f"decision: {word} (hazard probability {decision['hazard_probability']:.2f})")
    return [*lines, f"pictures and forecast.json: {out}"]
