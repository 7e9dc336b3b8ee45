"""Which pictures the report shows of the data and of the decoder, and the figures made of them."""

import numpy as np
import torch
from jaxtyping import Float, Int
from matplotlib.figure import Figure
from torch import Tensor

from carff.evaluation_data import WHOLLY_VISIBLE, EvaluationData, Views, main_actor
from carff.figures import ReconstructionRow, contact_sheet, reconstruction_grid

SHEET_EGO, SHEET_OTHERS = 5, 3
TARGET_CAMERAS = 4


def contact_sheet_figure(evaluation: EvaluationData) -> Figure:
    """Draws every state from a few cameras, from those that show least of the main actor to those that show most."""
    table, views = evaluation.table, evaluation.views
    cameras = sheet_cameras(views, table.views.shape[1])
    pictures = np.stack([evaluation.pictures_at(camera) for camera in cameras], axis=1)
    names = [camera_name(evaluation, camera) for camera in cameras]
    name = main_actor(table)
    share = None if name is None else table.visible_fraction(name)[:, cameras]
    if share is None or (share < 0).any():
        return contact_sheet(pictures, evaluation.style, names)
    present = torch.tensor([any(box.name == name for box in boxes) for boxes in table.actors])
    # What this very view shows, unlike `Views.visibility`, which asks what the camera shows in any branch.
    level = (share > 0).long() + (share > WHOLLY_VISIBLE).long()
    visibility = torch.where(present[:, None], level, -1)
    return contact_sheet(pictures, evaluation.style, names, visibility.numpy(), share.clamp(max=1).numpy())


def reconstruction_figure(evaluation: EvaluationData, samples: Float[Tensor, "n d"]) -> Figure:
    """Draws what the decoder makes of up to three encoded views: determined, unseen, unseen and ambiguous."""
    rows = [_reconstruction(evaluation, samples, row) for row in example_views(evaluation.views)]
    return reconstruction_grid(rows, evaluation.style)


def sheet_cameras(views: Views, cameras: int) -> list[int]:
    """Chooses cameras for the contact sheet, ordered by what they show: mostly the ego's, and a few of the others."""
    shown = torch.zeros(cameras).index_add(0, views.camera, views.visibility.clamp(min=0).float())
    chosen: list[int] = []
    for own, count in ((views.ego, SHEET_EGO), (~views.ego, SHEET_OTHERS)):
        candidates = views.camera[own].unique()
        ordered = candidates[shown[candidates].argsort(stable=True)]
        places = torch.linspace(0, max(len(ordered) - 1, 0), min(count, len(ordered))).round().long()
        chosen += ordered[places].tolist()
    return chosen


def camera_name(evaluation: EvaluationData, camera: int) -> str:
    """Returns a camera's kind and number, with a note where it was never trained on."""
    kind = {"birds_eye": "bird's-eye", "unknown": "camera"}.get(
        evaluation.table.camera_kinds[camera], evaluation.table.camera_kinds[camera]
    )
    views = evaluation.views
    unseen = bool(views.test[views.camera == camera].any())
    return f"{kind} {camera}{' (test)' if unseen else ''}"


def example_views(views: Views) -> list[int]:
    """Chooses a determined train view, a determined and an ambiguous test view, as far as they exist, from the ego."""
    # Of the determined views those that show most, of the ambiguous ones those that show least.
    wanted = (
        (views.train & views.determined, torch.amax),
        (views.test & views.determined, torch.amax),
        (views.test & ~views.determined, torch.amin),
    )
    rows = []
    for kind, extreme in wanted:
        candidates = kind & views.ego if (kind & views.ego).any() else kind
        if candidates.any():
            found = (candidates & (views.visibility == extreme(views.visibility[candidates], 0))).nonzero()[:, 0]
            rows.append(int(found[len(found) // 2]))
    return rows or [0]


def _reconstruction(evaluation: EvaluationData, samples: Float[Tensor, "n d"], row: int) -> ReconstructionRow:
    views, table, model = evaluation.views, evaluation.table, evaluation.model
    state, camera = int(views.state[row]), int(views.camera[row])
    targets = target_cameras(table.view_index("train")[state], camera)
    device = next(model.pcvae.parameters()).device
    decoded = model.pcvae.decode(samples[row].to(device).expand(len(targets), -1), targets.to(device))
    return ReconstructionRow(
        encoded=evaluation.data.images[views.frame[row]].numpy(),
        encoded_state=state,
        title=f"{evaluation.style.name(state)}, {camera_name(evaluation, camera)}",
        truths=evaluation.pictures_at(camera),
        targets=evaluation.data.images[table.views[state, targets]].numpy(),
        decoded=decoded.cpu().numpy(),
        target_names=tuple(camera_name(evaluation, target) for target in targets.tolist()),
    )


def target_cameras(trained: Int[Tensor, " cameras"], camera: int, count: int = TARGET_CAMERAS) -> Int[Tensor, " k"]:
    """Chooses cameras to decode at, from the last one back, spread over all that were trained on but the encoder's own.

    In the usual order of kinds (ego, elevated, bird's-eye) the bird's-eye camera comes first.
    """
    others = [other for other in (trained >= 0).nonzero()[:, 0].tolist() if other != camera][::-1] or [camera]
    places = torch.linspace(0, len(others) - 1, min(count, len(others))).round().long()
    return torch.tensor(others)[places]
