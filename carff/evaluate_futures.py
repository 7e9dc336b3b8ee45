"""Two pictures and their futures: one that settles what comes next, one that leaves it open (CARFF Fig. 2, 6).

Both are unseen (test cameras) where the data has such views, and the ego's own. Sampled futures are rendered from the
bird's-eye camera and from the ego camera that would show most of the main actor, beside the ground truth.
"""

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Int, UInt8
from torch import Tensor

from carff.evaluate_scenes import BIRDS_EYE, render_scenes
from carff.evaluation_data import NONE, EvaluationData, Part, main_actor, one_label
from carff.evaluation_pictures import camera_name
from carff.figures import Futures, futures_strip
from carff.states import branch_ambiguous
from hashnerf.figure_style import png_bytes

SHOWN = 5
DRAWS = 100
SHOWN_WIDTH = 80  # pixels: about what the report shows them with


def evaluate_futures(evaluation: EvaluationData) -> Part:
    """Returns a strip of sampled futures for a clear and for an occluded picture."""
    views, goes_on = evaluation.views, evaluation.goes_on()
    several = branch_ambiguous(evaluation.groups, evaluation.table.branch)[views.state, views.camera]
    rows = goes_on.nonzero()[:, 0]
    after = evaluation.same_boxes[evaluation.table.successor[views.state[rows]]]
    settled = torch.zeros_like(goes_on).index_put((rows,), one_label(views.picture[rows], after))
    telling = settled & views.shows_actor if (settled & views.shows_actor).any() else settled
    best = views.visibility == views.visibility[telling].max() if telling.any() else telling
    several &= goes_on
    hidden = several & (views.visibility == NONE) if (several & (views.visibility == NONE)).any() else several
    kinds = {
        "futures_clear": (telling & best, "no picture settles what comes next"),
        "futures_occluded": (hidden, "no picture fits several branches"),
    }
    figures, reasons = {}, {}
    for name, (kind, reason) in kinds.items():
        row = example_view(evaluation, kind)
        if row is None:
            reasons[name] = reason
        else:
            figures[name] = png_bytes(futures_strip(futures_of(evaluation, row), evaluation.style))
    return Part({}, figures, reasons)


def example_view(evaluation: EvaluationData, kind: Bool[Tensor, " n"]) -> int | None:
    """Returns the middle one of the views of a kind, of test and ego cameras where there are such; None without."""
    for wish in (evaluation.views.test & evaluation.views.ego, evaluation.views.ego, torch.ones_like(kind)):
        found = (kind & wish).nonzero()[:, 0]
        if len(found):
            return int(found[len(found) // 2])
    return None


@torch.no_grad()
def futures_of(evaluation: EvaluationData, row: int) -> Futures:
    """Samples, renders and probes the futures of one view."""
    views, model, table = evaluation.views, evaluation.model, evaluation.table
    belief = views.belief.select(torch.tensor([row]))
    mixture = model.mdn(belief.mean, belief.logvar)
    latents = mixture.sample(DRAWS, evaluation.generator(8))[0]
    same_picture = (views.picture == views.picture[row]) & evaluation.goes_on()
    now = views.state[same_picture]
    after, place = table.successor[now].unique(return_inverse=True)
    times = torch.zeros(len(after)).index_add_(0, place, table.branch_weight[table.branch[now]])
    states = named_as(model.probe_latents(latents), after, evaluation.same_boxes)
    counts = torch.bincount(torch.where(states < 0, len(table), states), minlength=len(table) + 1)
    cameras = shown_cameras(evaluation, after.tolist())
    rendered = [render_scenes(model.nerf, evaluation, latents[:SHOWN], camera, SHOWN_WIDTH) for camera in cameras]
    state, camera = int(views.state[row]), int(views.camera[row])
    return Futures(
        image=evaluation.data.images[views.frame[row]].numpy(),
        title=f"{evaluation.style.name(state)}, {camera_name(evaluation, camera)}",
        view_names=tuple(camera_name(evaluation, camera) for camera in cameras),
        true_states=tuple(after.tolist()),
        true_probability=tuple((times / times.sum()).tolist()),
        true_pictures=np.stack([shrunk(evaluation.pictures_at(camera)[after.numpy()]) for camera in cameras], axis=1),
        sampled_states=tuple(states[:SHOWN].tolist()),
        sampled_pictures=np.stack(rendered, axis=1),
        mixture_weights=tuple(mixture.log_weights[0].exp().tolist()),
        state_probability=tuple((counts / DRAWS).tolist()),
        draws=DRAWS,
    )


def named_as(
    answers: Int[Tensor, " n"], expected: Int[Tensor, " k"], same_boxes: Int[Tensor, " states"]
) -> Int[Tensor, " n"]:
    """Returns the probe's answers; one that stands for several states with equal boxes is named as the expected one."""
    named = answers.clone()
    for state in expected.flip(0).tolist():
        named[(answers >= 0) & (same_boxes[answers.clamp(min=0)] == same_boxes[state])] = state
    return named


def shown_cameras(evaluation: EvaluationData, states: list[int]) -> list[int]:
    """Returns the bird's-eye camera, if any, and the ego camera that shows most of the main actor in these states."""
    table = evaluation.table
    chosen = evaluation.model.scene.cameras_of(BIRDS_EYE)[:1]
    ego = sorted(set(evaluation.views.camera[evaluation.views.ego].tolist()))
    name = main_actor(table)
    if not ego:
        return chosen or [0]
    if name is None:
        return [*chosen, ego[0]]
    pixels = table.visible_px[states][:, ego, table.actor_index(name)]
    return [*chosen, ego[int(pixels.amax(dim=0).argmax())]]


def shrunk(pictures: UInt8[np.ndarray, "n h w 3"]) -> UInt8[np.ndarray, "n h2 w2 3"]:
    """Pictures at the size at which futures are rendered."""
    height, width = pictures.shape[1:3]
    if width <= SHOWN_WIDTH:
        return pictures
    size = (SHOWN_WIDTH, max(1, round(height * SHOWN_WIDTH / width)))
    return np.stack([cv2.resize(picture, size, interpolation=cv2.INTER_AREA) for picture in pictures])
