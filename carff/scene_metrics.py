"""How well rendered scenes agree with their own ground truth, and better with it than with any other state (CARFF
Tables 2, 6).

Notation: all pictures of one comparison come from ONE camera. `rendered` [r, h, w, 3] are predictions or toggles,
`truth` [s, h, w, 3] the ground truth of every state, both uint8 or float in [0, 1]; `row_state` [r] says which state
each rendering claims to show. PSNR is in dB against a peak of 1 and +inf for identical pictures: averages leave those
out and count them, because one infinity would hide all others.

Most of a picture is the same in every state, so whole-picture PSNR flatters. The changed-pixel figures look only where
states differ: `changed_px_db` on the pixels where any two states differ; the *lead* of a pair of states on the pixels
where those two differ, the same pixels on both sides of the subtraction.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from hashnerf.unit_pictures import unit_pictures

# Two ground-truth pixels count as different beyond this step in any channel (8 of 255 levels: above dithering, below a
# shadow's edge).
CHANGE_THRESHOLD = 8 / 255


@dataclass(frozen=True)
class ChangedPsnr:
    """PSNR in dB on changed pixels, one row per rendering; NaN where nothing differs or there is no other state."""

    matched: Float[np.ndarray, " r"]
    """Against its own state, on the pixels of the mask."""
    unmatched: Float[np.ndarray, " r"]
    """Against another state, on the pixels where that state differs from its own; averaged over the other states."""
    lead: Float[np.ndarray, " r"]
    """Own minus other on those same pixels, averaged over the other states."""


def psnr_db(mse: Float[np.ndarray, "*batch"] | float) -> Float[np.ndarray, "*batch"]:
    """Peak signal-to-noise ratio in dB of a mean squared error of unit pictures; +inf for 0, NaN for NaN."""
    with np.errstate(divide="ignore"):
        return np.asarray(-10.0 * np.log10(np.asarray(mse, dtype=np.float64)))


def mean_psnr_db(values: Float[np.ndarray, "*batch"]) -> float | None:
    """Mean of the finite PSNRs (identical pictures and empty masks left out); None where nothing finite remains."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else None


def psnr_matrix(
    rendered: Shaped[np.ndarray, "r h w 3"], truth: Shaped[np.ndarray, "s h w 3"]
) -> Float[np.ndarray, "r s"]:
    """PSNR in dB of every rendering against the ground truth of every state (CARFF Table 6)."""
    truth = unit_pictures(truth)
    return psnr_db(np.stack([((truth - picture) ** 2).mean(axis=(1, 2, 3)) for picture in unit_pictures(rendered)]))


def changed_pixels(
    truth: Shaped[np.ndarray, "s h w 3"], threshold: float = CHANGE_THRESHOLD
) -> Bool[np.ndarray, "h w"]:
    """Pixels of one camera where at least two states differ by more than `threshold` in some channel."""
    truth = unit_pictures(truth)
    return (truth.max(axis=0) - truth.min(axis=0)).max(axis=-1) > threshold


def equal_states(truth: Shaped[np.ndarray, "s h w 3"], threshold: float = CHANGE_THRESHOLD) -> Bool[np.ndarray, "s s"]:
    """Which states this camera cannot tell apart: no pixel differs by more than `threshold`."""
    truth = unit_pictures(truth)
    return np.stack([np.abs(truth - picture).max(axis=(1, 2, 3)) <= threshold for picture in truth])


def changed_psnr(
    rendered: Shaped[np.ndarray, "r h w 3"],
    truth: Shaped[np.ndarray, "s h w 3"],
    mask: Bool[np.ndarray, "h w"],
    row_state: Int[np.ndarray, " r"] | None = None,
    threshold: float = CHANGE_THRESHOLD,
) -> ChangedPsnr:
    """PSNR where states differ: matched on `mask`, unmatched and lead on the pixels that the two states differ in."""
    rendered, truth = unit_pictures(rendered), unit_pictures(truth)
    matched, unmatched, lead = [], [], []
    for picture, own in zip(rendered, _rows(rendered, row_state)):
        own_error = ((picture - truth[own]) ** 2).mean(axis=-1)
        matched.append(psnr_db(_masked_mean(own_error, mask)))
        others, leads = [], []
        for other in range(len(truth)):
            differ = np.abs(truth[own] - truth[other]).max(axis=-1) > threshold
            if differ.any():
                others.append(psnr_db(_masked_mean(((picture - truth[other]) ** 2).mean(axis=-1), differ)))
                leads.append(psnr_db(_masked_mean(own_error, differ)) - others[-1])
        unmatched.append(np.mean(others) if others else np.nan)
        lead.append(np.mean(leads) if leads else np.nan)
    return ChangedPsnr(np.array(matched), np.array(unmatched), np.array(lead))


def state_identified(
    matrix: Float[np.ndarray, "r s"],
    equivalents: Bool[np.ndarray, "s s"],
    row_state: Int[np.ndarray, " r"] | None = None,
) -> Bool[np.ndarray, " r"]:
    """Whether each rendering is nearest to its own ground truth; states with the same picture count as one."""
    return equivalents[_rows(matrix, row_state), matrix.argmax(axis=1)]


def scene_summary(
    rendered: Shaped[np.ndarray, "r h w 3"],
    truth: Shaped[np.ndarray, "s h w 3"],
    row_state: Int[np.ndarray, " r"] | None = None,
    threshold: float = CHANGE_THRESHOLD,
) -> dict:
    """Every figure of one camera: matched, unmatched and changed-pixel PSNR, the lead, the states identified.

    Figures that do not exist (one state only, nothing changes) are None.
    """
    rows = _rows(rendered, row_state)
    matrix, equal = psnr_matrix(rendered, truth), equal_states(truth, threshold)
    matched, mask = matrix[np.arange(len(rows)), rows], changed_pixels(truth, threshold)
    changed, identified = changed_psnr(rendered, truth, mask, rows, threshold), state_identified(matrix, equal, rows)
    finite = matched[np.isfinite(matched)]
    return {
        "psnr_matched_db": mean_psnr_db(matched),
        "psnr_matched_min_db": float(finite.min()) if finite.size else None,
        "psnr_matched_of_mean_mse_db": mean_psnr_db(psnr_db((10 ** (-matched / 10)).mean(keepdims=True))),
        "psnr_unmatched_db": mean_psnr_db(matrix[~equal[rows]]),
        "identical": int(np.isinf(matched).sum()),
        "changed_px_db": mean_psnr_db(changed.matched),
        "changed_px_unmatched_db": mean_psnr_db(changed.unmatched),
        "changed_px_lead_db": mean_psnr_db(changed.lead),
        "changed_px_count": int(mask.sum()),
        "changed_px_share": float(mask.mean()),
        "state_identified": float(identified.mean()),
        "state_identified_count": int(identified.sum()),
        "states": len(rows),
        "psnr_matrix_db": [[float(value) if np.isfinite(value) else None for value in row] for row in matrix],
    }


def _rows(rendered: np.ndarray, row_state: np.ndarray | None) -> np.ndarray:
    return np.arange(len(rendered)) if row_state is None else row_state


def _masked_mean(values: Float[np.ndarray, "h w"], mask: Bool[np.ndarray, "h w"]) -> float:
    return float(values[mask].mean()) if mask.any() else float("nan")
