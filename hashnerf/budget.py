"""Choosing what a budget allows: the most accurate preset whose cost, as measured here and now, fits."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np

from hashnerf.errors import UserError
from hashnerf.report_tables import Table
from hashnerf.results_page import table_lines

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
        raise UserError(
            f"{key} is {budget:g}: no preset fits {MARGIN:g} times over ({listed}); give at least {least:.3g}"
        )
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


@dataclass(frozen=True)
class Trial:
    """A budget, what was chosen within it, and what that took."""

    budget: float
    chosen: str
    taken: float


def trials_table(trials: Sequence[Trial], unit: str) -> Table:
    """Returns one row a budget: what was chosen, what it took at least and at most, and how often it fitted."""
    rows = []
    for budget in dict.fromkeys(trial.budget for trial in trials):
        own = [trial for trial in trials if trial.budget == budget]
        kept = sum(trial.taken <= budget for trial in own)
        taken = [trial.taken for trial in own]
        chosen = ", ".join(dict.fromkeys(trial.chosen for trial in own))
        verdict = f"{kept} of {len(own)}{'' if kept == len(own) else ' (**missed**)'}"
        rows.append((f"{budget:g} {unit}", chosen, f"{min(taken):.3g} to {max(taken):.3g} {unit}", verdict))
    return Table(("budget", "chosen", "took", "within the budget"), tuple(rows))


def write_trials(parts: Mapping[str, tuple[str, Iterable[Trial]]], page: Path, about: str) -> None:
    """Writes a page of trials, by title with their unit, anew after every one: a trial that fails costs no other."""
    lines = ["# Whether budgets are kept", "", about]
    for title, (unit, trials) in parts.items():
        done: list[Trial] = []
        section: list[str] = []
        for trial in trials:
            done.append(trial)
            section = ["", f"## {title}", "", *table_lines(trials_table(done, unit))]
            page.write_text("\n".join([*lines, *section]) + "\n", encoding="utf-8")
        lines += section
