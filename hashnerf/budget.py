"""Choosing what a budget allows: the most accurate preset whose cost, as measured here and now, fits."""

from collections.abc import Callable, Mapping
from time import perf_counter

import numpy as np

from hashnerf.errors import UserError

MARGIN = 1.3
"""Measured costs count this many times: a machine that others use, too, is not always as fast as a moment ago."""


def best_within(costs: Mapping[str, float], budget: float, key: str, unit: str) -> tuple[str, str]:
    """Returns the last of the presets (from the least to the most accurate) that fits, and one line that says why.

    `costs` are as expected, in the budget's unit; `key` is the setting that gave the budget. Raises UserError where not
    even the cheapest fits.
    """
    fitting = [name for name, cost in costs.items() if MARGIN * cost <= budget]
    listed = ", ".join(f"{name} {cost:.3g} {unit}" for name, cost in costs.items())
    if not fitting:
        least = MARGIN * min(costs.values())
        raise UserError(f"{key} is {budget:g}: no preset fits ({listed}); give at least {least:.3g}")
    chosen = fitting[-1]
    return chosen, f"{key} {budget:g}: takes {chosen}, the most accurate that fits {MARGIN:g} times over ({listed})"


def p95_ms(function: Callable[[], object], calls: int) -> float:
    """Returns the milliseconds that 95 % of some calls stay below, after two that warm up."""
    taken = []
    for call in range(calls + 2):
        start = perf_counter()
        function()
        if call >= 2:
            taken.append(1000 * (perf_counter() - start))
    return float(np.quantile(taken, 0.95))
