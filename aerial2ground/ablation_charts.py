"""Figures of the road prior: numbers part by part, and the same views with more and more of it."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import UInt8
from matplotlib.figure import Figure

from aerial2ground.report_tables import UNITS, VIEW_LABELS
from aerial2ground.report_words import COLOURS, PRIORS, VIEW_FIGURES
from hashnerf.figure_style import FULL_WIDTH, INK, MUTED, SMALL, new_figure, show_picture, style_chart
from hashnerf.report_tables import number

PLACES = 4
"""Places shown in the figure of views."""


def priors_chart(ground: Mapping[str, Mapping]) -> Figure:
    """Each figure of views from the ground with no prior, its colour, its distance, and free space."""
    shown = [key for key in VIEW_FIGURES if any(value is not None for value in ground.get(key, {}).values())]
    rows = -(-len(shown) // 3)
    figure = new_figure(FULL_WIDTH, 2.2 * rows + 0.1)
    panels = list(figure.subplots(rows, 3, squeeze=False).flat)
    for axes, key in zip(panels, shown):
        found = [
            (place, prior, ground[key][prior])
            for place, prior in enumerate(PRIORS)
            if ground[key].get(prior) is not None
        ]
        axes.plot([place for place, _, _ in found], [value for _, _, value in found], color=MUTED, linewidth=1)
        for place, prior, value in found:
            axes.plot(place, value, marker="o", markersize=8, color=COLOURS[prior], zorder=3)
            text = number(value, UNITS[key]).split(" ")[0]
            axes.annotate(text, (place, value), (0, 8), textcoords="offset points", ha="center", fontsize=SMALL + 0.5)
        unit = f" ({UNITS[key]})" if UNITS[key] else ""
        style_chart(axes, f"{VIEW_LABELS[key]}{unit}")
        axes.set_xlim(-0.5, len(PRIORS) - 0.5)
        axes.set_xticks(range(len(PRIORS)), [label.replace(" + ", "\n+ ") for label in PRIORS.values()])
        axes.margins(y=0.3)
        if UNITS[key] == "m":
            axes.set_ylim(bottom=0)
    for axes in panels[len(shown) :]:
        axes.axis("off")
    return figure


def split_views(
    sheet: UInt8[np.ndarray, "sheet_h sheet_w 3"], height: int, width: int
) -> list[tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]] | None:
    """Returns the (truth, view) pairs of a ground_views.png, line by line; None for a sheet of another grid."""
    down, across = sheet.shape[0] // (2 * height), sheet.shape[1] // width
    if (2 * height * down, width * across) != sheet.shape[:2] or not down * across:
        return None
    grid = sheet.reshape(down, 2, height, across, width, 3)
    return [(grid[row, 0, :, column], grid[row, 1, :, column]) for row in range(down) for column in range(across)]


def prior_views(
    truth: Sequence[UInt8[np.ndarray, "h w 3"]], views: Mapping[str, Sequence[UInt8[np.ndarray, "h w 3"]]]
) -> Figure:
    """The truth above, and below it the same places with more and more of the road prior."""
    chosen = np.unique(np.linspace(0, len(truth) - 1, min(PLACES, len(truth))).round().astype(int))
    lines = [("truth", truth), *((PRIORS[prior], views[prior]) for prior in PRIORS if prior in views)]
    height, width = truth[0].shape[:2]
    each = FULL_WIDTH / len(chosen)
    figure = new_figure(FULL_WIDTH, (each * height / width + 0.06) * len(lines))
    panels = figure.subplots(len(lines), len(chosen), squeeze=False)
    for row, (label, pictures) in zip(panels, lines):
        for axes, place in zip(row, chosen):
            show_picture(axes, pictures[place])
        row[0].set_ylabel(label, fontsize=SMALL + 1.5, color=INK)
    return figure
