"""Accuracy against cost of a sweep: one line a knob, the Pareto front, the chosen presets."""

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import LogLocator, NullFormatter

from hashnerf.figure_style import (
    AMBER,
    BLUE,
    FULL_WIDTH,
    GREEN,
    INK,
    MUTED,
    PURPLE,
    SKY,
    SMALL,
    VERMILION,
    new_figure,
    style_chart,
)
from hashnerf.sweep import COMBINED, Sweep
from hashnerf.sweep_presets import front_of, measured
from hashnerf.sweep_runs import Result

COLOURS = (BLUE, GREEN, PURPLE, AMBER, SKY)
MARKERS = "osD^vPX"
FRONT_ALPHA = 0.35
WIDE = 4.0
"""Costs further apart than this factor are drawn on a logarithmic axis."""


def sweep_chart(sweep: Sweep, results: Sequence[Result], presets: Mapping[str, Result]) -> Canvas:
    """Returns accuracy over cost; better accuracy is up, whichever sign it has."""
    rows = measured(sweep, results)
    figure = new_figure(FULL_WIDTH, 4.4)
    axes = figure.subplots()
    front = front_of(sweep, results)
    axes.plot(*_places(sweep, front), color=VERMILION, linewidth=7, alpha=FRONT_ALPHA, label="front", zorder=1)
    base = rows[:1]  # the base is part of every knob's line
    for number, knob in enumerate(sweep.knobs):
        line = sorted(base + [one for one in rows if one.row.knob == knob], key=lambda one: one.figures[sweep.cost])
        if len(line) > 1:
            colour, marker = COLOURS[number % len(COLOURS)], MARKERS[number % len(MARKERS)]
            axes.plot(*_places(sweep, line), marker=marker, color=colour, linewidth=1, markersize=4.5, label=knob)
    combined = [one for one in rows if one.row.knob == COMBINED]
    if combined:
        axes.plot(*_places(sweep, combined), "x", color=MUTED, markersize=6, label="combinations")
    axes.plot(*_places(sweep, base), "*", color=INK, markersize=11, label="base", zorder=4)
    for words, row in _named(presets):
        place = tuple(values[0] for values in _places(sweep, [row]))
        axes.plot(*place, "o", color=VERMILION, markersize=13, fillstyle="none", markeredgewidth=1.8, zorder=5)
        axes.annotate(words, place, (0, 11), textcoords="offset points", ha="center", fontsize=SMALL, color=VERMILION)
    axes.margins(x=0.12, y=0.12)
    costs = [one.figures[sweep.cost] for one in rows]
    if 0 < WIDE * min(costs) < max(costs):
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
    cost, accuracy = sweep.figures[sweep.cost], sweep.figures[sweep.accuracy]
    if not accuracy.more_is_better:
        axes.invert_yaxis()
    style_chart(axes, sweep.title, _axis(sweep.cost, cost.unit), _axis(sweep.accuracy, accuracy.unit))
    figure.legend(loc="outside right upper", fontsize=SMALL, frameon=False, labelcolor=INK)
    return figure


def _places(sweep: Sweep, rows: Sequence[Result]) -> tuple[list[float], list[float]]:
    cost, accuracy = (
        [one.figures[name] * sweep.figures[name].scale for one in rows] for name in (sweep.cost, sweep.accuracy)
    )
    return cost, accuracy


def _named(presets: Mapping[str, Result]) -> list[tuple[str, Result]]:
    """Returns the chosen rows with their names: one row may be several presets."""
    rows = {one.row.name: one for one in presets.values()}
    return [(", ".join(name for name, one in presets.items() if one is row), row) for row in rows.values()]


def _axis(name: str, unit: str) -> str:
    return f"{name} ({unit})" if unit else name
