"""Which rows of a sweep are worth their cost, which of them become presets, and which knobs buy nothing.

Presets are taken from the Pareto front, so none dominates another.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from hashnerf.pareto import monotonicity_violations, pareto_front
from hashnerf.sweep import BASE, Sweep
from hashnerf.sweep_runs import Result


def measured(sweep: Sweep, results: Sequence[Result]) -> list[Result]:
    """Returns the rows that did not fail, the base first."""
    return [one for one in results if sweep.cost in one.figures and sweep.accuracy in one.figures]


def front_of(sweep: Sweep, results: Sequence[Result]) -> list[Result]:
    """Returns the rows that no other dominates in cost and accuracy, the cheapest first."""
    rows = measured(sweep, results)
    return [rows[number] for number in pareto_front(_losses(sweep, rows))] if rows else []


def chosen_presets(sweep: Sweep, results: Sequence[Result]) -> dict[str, Result]:
    """Returns each preset's row: on the front the cheapest whose accuracy is close enough to the best."""
    front = front_of(sweep, results)
    if not front:
        return {}
    losses = [sweep.figures[sweep.accuracy].loss(one.figures[sweep.accuracy]) for one in front]
    best = min(losses)
    return {
        name: next(one for one, loss in zip(front, losses) if loss <= best + allowed)
        for name, allowed in sweep.presets.items()
    }


def worse_for_more(sweep: Sweep, results: Sequence[Result], knob: str) -> list[tuple[Result, Result]]:
    """Returns pairs (cheaper, dearer) of a knob's rows in which the dearer is less accurate by more than the noise."""
    rows = [one for one in measured(sweep, results) if one.row.knob in (BASE, knob)]
    losses = _losses(sweep, rows)
    pairs = monotonicity_violations(losses[:, 0], losses[:, 1], sweep.noise)
    return [(rows[cheaper], rows[dearer]) for cheaper, dearer in pairs]


def _losses(sweep: Sweep, rows: Sequence[Result]) -> Float[np.ndarray, "n 2"]:
    names = (sweep.cost, sweep.accuracy)
    values = [[sweep.figures[name].loss(one.figures[name]) for name in names] for one in rows]
    return np.array(values, dtype=float).reshape(-1, 2)
