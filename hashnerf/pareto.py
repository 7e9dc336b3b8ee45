"""Which of several settings are worth their cost: the Pareto front, and whether more cost ever buys less accuracy.

A *point* is a row of losses, smaller is better in every column: a cost as it is, an accuracy with its sign turned. A
point is *dominated* when another is no worse in any column and better in one; equal points do not dominate each other.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from hashnerf.errors import UserError


def dominated(points: Float[np.ndarray, "n columns"]) -> Bool[np.ndarray, " n"]:
    """Returns which points another one dominates; raises UserError for a number that is not finite."""
    if not np.isfinite(points).all():
        raise UserError("a point of the trade-off is not finite; leave that row out")
    no_worse = (points[:, None] <= points[None]).all(axis=2)
    better = (points[:, None] < points[None]).any(axis=2)
    return (no_worse & better).any(axis=0)


def pareto_front(points: Float[np.ndarray, "n columns"]) -> Int[np.ndarray, " m"]:
    """Returns the rows that no other dominates, by the first column; of equal points only the first."""
    _, first = np.unique(points, axis=0, return_index=True)
    kept = np.zeros(len(points), dtype=bool)
    kept[first] = True
    rows = np.flatnonzero(kept & ~dominated(points))
    return rows[np.argsort(points[rows, 0], kind="stable")]


def monotonicity_violations(
    cost: Float[np.ndarray, " n"], loss: Float[np.ndarray, " n"], noise: float
) -> list[tuple[int, int]]:
    """Returns pairs (cheaper, dearer) in which the dearer point is worse by more than `noise`.

    For every dearer point the pair with the best of all cheaper ones; points of equal cost are not compared.
    """
    if not noise >= 0:
        raise UserError(f"noise is {noise}; give 0 or a positive number")
    pairs = []
    for dearer in np.argsort(cost, kind="stable").tolist():
        cheaper = np.flatnonzero(cost < cost[dearer])
        if len(cheaper):
            best = int(cheaper[np.argmin(loss[cheaper])])
            if loss[dearer] > loss[best] + noise:
                pairs.append((best, dearer))
    return pairs
