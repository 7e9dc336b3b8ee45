"""The belief part of the report: what is in the data, how well latents name states, how well pictures come back.

State labels are state numbers, latents are posterior *means* for the support vector machine and one posterior *sample*
per view for reconstruction and the map. Accuracies are shares in [0, 1], PSNR is in dB.
"""

import json
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from carff.beliefs import active_units, reparameterise
from carff.charts import latent_map, psnr_curve
from carff.evaluation_data import BeliefData, EvaluationData, Part, Views, actor_visible
from carff.evaluation_pictures import contact_sheet_figure, reconstruction_figure
from carff.latent_metrics import subset_accuracy, svm_accuracy, svm_heldout, tsne_embedding
from carff.scene_metrics import changed_pixels, mean_psnr_db, psnr_db
from carff.states import state_ceiling
from hashnerf.errors import UserError
from hashnerf.figure_style import png_bytes

MOST_MAP_POINTS = 600
VISIBLE_FIGURES = ("svm_visible", "svm_visible_gap")
HELDOUT_FIGURES = ("svm_visible_heldout", "svm_visible_heldout_gap")
DECODED_AT_ONCE = 32


def evaluate_beliefs(evaluation: EvaluationData) -> Part:
    """Returns the data overview and everything about the PC-VAE."""
    views = evaluation.views
    scores, reasons = svm_scores(evaluation.beliefs)
    samples = reparameterise(views.belief, evaluation.generator(1))
    pcvae = scores | {"active_units": int(active_units(views.select(views.train).belief.mean).sum())}
    # states that are points in the latent space span one dimension less than there are of them
    pcvae["needed_units"] = min(len(evaluation.table) - 1, views.belief.mean.shape[1])
    pcvae |= reconstruction_scores(evaluation.beliefs, samples)
    figures = {
        "contact_sheet": png_bytes(contact_sheet_figure(evaluation)),
        "reconstructions": png_bytes(reconstruction_figure(evaluation, samples)),
    }
    shown = torch.randperm(len(views), generator=evaluation.generator(2))[:MOST_MAP_POINTS]
    if len(shown) >= 4:
        points = tsne_embedding(samples[shown].numpy(), evaluation.config.seed)
        chart = latent_map(points, views.state[shown].numpy(), views.determined[shown].numpy(), evaluation.style)
        figures["tsne"] = png_bytes(chart)
    curve = read_curve(evaluation.config.folder / "pcvae" / "metrics.jsonl")
    if len(curve):
        figures["psnr_train"] = png_bytes(psnr_curve(curve[:, 0], curve[:, 1]))
    else:
        reasons["psnr_train"] = "the run keeps no record of the PC-VAE's training (pcvae/metrics.jsonl)"
    return Part({"data": describe_data(evaluation), "pcvae": pcvae}, figures, reasons)


def describe_data(evaluation: EvaluationData) -> dict:
    """Returns how much data there is, and how many pictures leave their state open."""
    views, table = evaluation.views, evaluation.table
    return {
        "states": len(table),
        "branches": list(table.branch_names),
        "cameras": table.views.shape[1],
        "test_cameras": len(views.camera[views.test].unique()),
        "views": len(views),
        "image_size": [evaluation.data.cameras.width, evaluation.data.cameras.height],
        "determined_views": int(views.determined.sum()),
        "ambiguous_views": int((~views.determined).sum()),
    }


def svm_scores(evaluation: BeliefData) -> tuple[dict, dict[str, str]]:
    """Returns the accuracies of naming states from latents, and reasons for those that cannot be measured."""
    train, test = (evaluation.views.select(rows) for rows in (evaluation.views.train, evaluation.views.test))
    train_groups = torch.where(evaluation.table.view_index("train") >= 0, evaluation.groups, -1)
    scores: dict = {"svm_ceiling": state_ceiling(train_groups)}
    for name, split in (("svm_visible", "train"), ("svm_visible_heldout", "test")):
        judged = actor_visible(evaluation.table) & (evaluation.table.view_index(split) >= 0)
        if judged.any():
            scores[f"{name}_ceiling"] = state_ceiling(torch.where(judged, evaluation.groups, -1))
    means, labels = train.belief.mean.numpy(), train.state.numpy()
    try:
        score = svm_accuracy(means, labels, groups=train.picture.numpy())
    except UserError as error:
        keys = ("svm_all", "svm_gap", *VISIBLE_FIGURES, *HELDOUT_FIGURES)
        return scores, dict.fromkeys((f"pcvae.{key}" for key in keys), str(error))
    reasons = {}
    scores |= _named("svm_all", score.correct, np.ones(len(train), dtype=bool))
    scores |= {"svm_folds": score.folds, "svm_chance": score.chance}
    scores |= _named("svm_visible", score.correct, train.shows_actor.numpy())
    scores |= _named("svm_determined", score.correct, train.determined.numpy())
    if len(test):
        unseen = svm_heldout(means, labels, test.belief.mean.numpy(), test.state.numpy())
        scores |= _named("svm_heldout", unseen.correct, np.ones(len(test), dtype=bool))
        scores |= _named("svm_visible_heldout", unseen.correct, test.shows_actor.numpy())
    if scores["svm_visible"] is None:
        reason = "no training view shows an actor, or the data does not say which do (visibility)"
        reasons |= dict.fromkeys((f"pcvae.{key}" for key in VISIBLE_FIGURES), reason)
    if scores.get("svm_visible_heldout") is None:
        reason = "no view of a test camera shows an actor, or the data does not say so"
        reasons |= dict.fromkeys((f"pcvae.{key}" for key in HELDOUT_FIGURES), reason)
    return scores, reasons


def reconstruction_scores(evaluation: BeliefData, samples: Float[Tensor, "n d"]) -> dict:
    """Returns the PSNR of decoded posterior samples, one per view, each at a random other train camera of its state."""
    views = evaluation.views
    scores: dict = {}
    for suffix, own in (("train", views.train), ("heldout", views.test)):
        rows = own.nonzero()[:, 0]
        whole, changed, baseline = decoded_psnr(evaluation, views.select(rows), samples[rows])
        scores[f"psnr_{suffix}_db"] = mean_psnr_db(whole)
        # A picture that comes back exactly counts without limit in a mean of decibels, but little in this one.
        mse = 10 ** (-whole / 10)
        scores[f"psnr_{suffix}_of_mean_mse_db"] = mean_psnr_db(psnr_db(mse.mean(keepdims=True))) if mse.size else None
        if suffix == "train":
            scores |= {"changed_px_db": mean_psnr_db(changed), "psnr_mean_image_db": mean_psnr_db(baseline)}
        else:
            scores["changed_px_heldout_db"] = mean_psnr_db(changed)
    return scores


def decoded_psnr(
    evaluation: BeliefData, views: Views, samples: Float[Tensor, "n d"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Returns each view's PSNR in dB: whole picture, changed pixels (NaN without), and of the camera's mean picture."""
    index = evaluation.table.view_index("train")
    target = other_cameras(index, views.state, views.camera, evaluation.generator(3))
    frames = index[views.state, target]
    images, pcvae = evaluation.data.images, evaluation.pcvae
    device = next(pcvae.parameters()).device
    masks, means = _camera_pictures(evaluation, index)
    errors = []
    for rows in torch.arange(len(views)).split(DECODED_AT_ONCE):
        truth = images[frames[rows]].float() / 255
        decoded = pcvae.decode(samples[rows].to(device), target[rows].to(device)).cpu()
        squared = (decoded - truth).square().mean(dim=-1)
        mask = masks[target[rows]].float()
        # 0 / 0 is NaN where a camera sees no change: such views have no changed-pixel figure
        changed = (squared * mask).sum(dim=(1, 2)) / mask.sum(dim=(1, 2))
        plain = (means[target[rows]] - truth).square().mean(dim=(1, 2, 3))
        errors.append(torch.stack([squared.mean(dim=(1, 2)), changed, plain]))
    whole, changed, baseline = torch.cat(errors, dim=1).double().numpy() if errors else np.zeros((3, 0))
    return psnr_db(whole), psnr_db(changed), psnr_db(baseline)


def other_cameras(
    index: Int[Tensor, "states cameras"],
    state: Int[Tensor, " n"],
    camera: Int[Tensor, " n"],
    generator: torch.Generator,
) -> Int[Tensor, " n"]:
    """Draws for each view another camera that has a picture of its state (the view's own, where no other has one)."""
    allowed = index[state] >= 0
    own = torch.nn.functional.one_hot(camera, index.shape[1]).bool()
    others = allowed & ~own
    choice = torch.where(others.any(dim=1, keepdim=True), others, own)
    return torch.multinomial(choice.float(), 1, generator=generator)[:, 0]


def read_curve(path: Path) -> Float[np.ndarray, "k 2"]:
    """Returns (seconds, PSNR in dB) of every logged training step; no rows where the file is missing."""
    if not path.is_file():
        return np.zeros((0, 2))
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    pairs = [(line["seconds"], line["psnr"]) for line in lines if line.get("psnr") is not None]
    return np.array(pairs, dtype=np.float64).reshape(-1, 2)


def _camera_pictures(
    evaluation: BeliefData, index: Int[Tensor, "states cameras"]
) -> tuple[Bool[Tensor, "cameras h w"], Float[Tensor, "cameras h w 3"]]:
    """Returns every camera's changed pixels and mean picture over its states."""
    height, width = evaluation.data.images.shape[1:3]
    masks = torch.zeros(index.shape[1], height, width, dtype=torch.bool)
    means = torch.zeros(index.shape[1], height, width, 3)
    for camera in range(index.shape[1]):
        rows = index[:, camera]
        pictures = evaluation.data.images[rows[rows >= 0]]
        if len(pictures):
            masks[camera] = torch.from_numpy(changed_pixels(pictures.numpy()))
            means[camera] = pictures.float().mean(dim=0) / 255
    return masks, means


def _named(key: str, correct: Bool[np.ndarray, " n"], mask: Bool[np.ndarray, " n"]) -> dict:
    found = subset_accuracy(correct, mask)
    return {key: found["accuracy"], f"{key}_interval": found["interval"], f"{key}_count": found["count"]}
