"""The scene part of the report: rendered beliefs against the ground truth of every state (CARFF Tables 2, 6).

All renderings of one comparison come from one camera: the bird's-eye camera, or without one the test camera that sees
most pixels change. A state that nothing precedes is *toggled*: the posterior mean of a train view that shows it wholly.
Every other state is *predicted*: one sample of the forecast from a train view that shows its predecessor wholly. Where
the predecessor leaves several states open, the first of 32 samples that the probe reads as the wanted state is taken.
Views and samples are drawn with the run's seed, one each: no best of several. The same latents go through the field
that was trained with the camera and through the one that never saw it.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from carff.charts import psnr_heatmap
from carff.evaluation_data import FULL, EvaluationData, Part
from carff.model import load_nerf
from carff.nerf import LatentNerf
from carff.scene_metrics import changed_pixels, equal_states, psnr_matrix, scene_summary
from carff.state_style import StateStyle
from hashnerf.figure_style import png_bytes

BIRDS_EYE = "birds_eye"
MOST_TRIES = 32


@dataclass(frozen=True)
class SceneLatents:
    """One latent a row, and whether it was forecast."""

    latents: Float[Tensor, "r d"]
    predicted: Bool[Tensor, " r"]


def evaluate_scenes(evaluation: EvaluationData) -> Part:
    """Returns PSNR, changed-pixel and identification figures at the camera trained on and held out."""
    camera = comparison_camera(evaluation)
    truth_rows = evaluation.table.views[:, camera]
    shown = (truth_rows >= 0).nonzero()[:, 0]
    truth = evaluation.data.images[truth_rows[shown]].numpy()
    scene = scene_latents(evaluation, shown)
    every = evaluation.style
    names = StateStyle(tuple(map(every.name, shown.tolist())), tuple(map(every.colour, shown.tolist())))
    results: dict = {"camera": camera, "camera_kind": evaluation.table.camera_kinds[camera], "states": len(shown)}
    figures: dict[str, bytes] = {}
    reasons = {}
    columns = {"_heldout": load_nerf(evaluation.model.config, evaluation.model.scene, held_out=True)[0]}
    if trained_on(evaluation, camera):
        columns[""] = evaluation.model.nerf
    else:
        sentence = f"no radiance field was trained with camera {camera}, which is held out: see the held-out figures"
        keys = ("psnr_matched_db", "psnr_unmatched_db", "changed_px_db", "changed_px_lead_db", "state_identified")
        reasons = {f"nerf.{key}": sentence for key in keys} | {"psnr_matrix": sentence}
    for suffix, nerf in columns.items():
        rendered = render_scenes(nerf, evaluation, scene.latents, camera)
        summary = scene_summary(rendered, truth)
        results |= {with_suffix(key, suffix): value for key, value in summary.items() if key != "states"}
        matrix, rows = psnr_matrix(rendered, truth), np.arange(len(shown))
        figure = psnr_heatmap(matrix, rows, scene.predicted.numpy(), equal_states(truth), names, "PSNR (dB)")
        figures[f"psnr_matrix{suffix}"] = png_bytes(figure)
    results["predicted"] = scene.predicted.tolist()
    return Part({"nerf": results}, figures, reasons)


def comparison_camera(evaluation: EvaluationData) -> int:
    """Returns the bird's-eye camera, or else the test camera (of all, without one) that sees most pixels change."""
    birds_eye = evaluation.model.scene.cameras_of(BIRDS_EYE)
    if birds_eye:
        return birds_eye[0]
    views = evaluation.views
    candidates = views.camera[views.test].unique() if views.test.any() else views.camera.unique()
    changes = []
    for camera in candidates.tolist():
        rows = evaluation.table.views[:, camera]
        changes.append(int(changed_pixels(evaluation.data.images[rows[rows >= 0]].numpy()).sum()))
    return int(candidates[int(np.argmax(changes))])


def trained_on(evaluation: EvaluationData, camera: int) -> bool:
    """Whether the field that forecasts are rendered with has seen a camera."""
    if not bool((evaluation.table.view_index("train")[:, camera] >= 0).any()):
        return False
    return evaluation.table.camera_kinds[camera] != BIRDS_EYE or (evaluation.config.folder / "nerf_birds_eye").is_dir()


@torch.no_grad()
def scene_latents(evaluation: EvaluationData, shown: Int[Tensor, " r"]) -> SceneLatents:
    """Returns one latent for each of the states in `shown`."""
    model, successor = evaluation.model, evaluation.table.successor
    generator = evaluation.generator(4)
    latents, predicted = [], []
    for state in shown.tolist():
        before = (successor == state).nonzero()[:, 0].tolist()
        belief = evaluation.views.belief.select(
            torch.tensor([telling_view(evaluation, [*before, state][0], generator)])
        )
        if not before:
            latents.append(belief.mean[0])
        else:
            samples = model.mdn(belief.mean, belief.logvar).sample(MOST_TRIES, generator)[0]
            latents.append(samples[_wanted(evaluation, before[0], state, samples)])
        predicted.append(bool(before))
    return SceneLatents(torch.stack(latents), torch.tensor(predicted))


def telling_view(evaluation: EvaluationData, state: int, generator: torch.Generator) -> int:
    """Draws a train view of a state that shows it wholly; the best there is where no view does.

    Best first: the picture determines the state, an ego camera, and one that shows all of the main actor.
    """
    views = evaluation.views
    candidates = views.train & (views.state == state)
    if not candidates.any():
        candidates = views.state == state
    for wish in (views.determined, views.visibility == FULL, views.ego):
        if (candidates & wish).any():
            candidates = candidates & wish
    rows = candidates.nonzero()[:, 0]
    return int(rows[torch.randint(len(rows), (1,), generator=generator)])


def render_scenes(
    nerf: LatentNerf, evaluation: EvaluationData, latents: Float[Tensor, "r d"], camera: int, width: int = 0
) -> UInt8[np.ndarray, "r h w 3"]:
    """Renders the scene of each latent from a camera, at most `width` pixels wide unless that is 0."""
    cameras = evaluation.model.scene.cameras
    if 0 < width < cameras.width:
        cameras = cameras.scaled(width, max(1, round(cameras.height * width / cameras.width)))
    pictures = torch.stack([nerf.picture(latent, cameras, camera) for latent in latents])
    return (pictures.clamp(0, 1) * 255).round().byte().numpy()


def with_suffix(key: str, suffix: str) -> str:
    """Puts a suffix before the unit: psnr_matched_db -> psnr_matched_heldout_db."""
    return f"{key.removesuffix('_db')}{suffix}_db" if key.endswith("_db") else f"{key}{suffix}"


def _wanted(evaluation: EvaluationData, before: int, state: int, samples: Float[Tensor, "n d"]) -> int:
    """The first sample; where no view settles the predecessor, the first one that shows the wanted state."""
    own = evaluation.views.train & (evaluation.views.state == before)
    if evaluation.views.determined[own].any():
        return 0
    found = (evaluation.model.probe_latents(samples) == evaluation.same_boxes[state]).nonzero()[:, 0]
    return int(found[0]) if len(found) else 0
