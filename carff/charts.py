"""Figures made of numbers: training curve, latents in the plane, PSNR matrix, curves, calibration, plans and drives.

Shares are in [0, 1] and drawn in per cent, PSNR is in dB, time in seconds. Intervals and bands are the 95 % ones that
the metrics computed. Every function returns a matplotlib figure; `figure_style.png_bytes` turns it into
a file.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from carff.forecast_metrics import VISIBILITY_CLASSES, AccuracyRecall, Curve
from carff.planning_metrics import PlanRow, policy_label
from carff.state_style import VISIBILITY_COLOURS, StateStyle
from hashnerf.figure_style import (
    AMBER,
    BLUE,
    FULL_WIDTH,
    GREEN,
    HALF_WIDTH,
    INK,
    MUTED,
    NORMAL,
    PAPER,
    SMALL,
    VERMILION,
    new_figure,
    style_chart,
)

SHOWN_DRAWS = (1, 5, 10, 20, 35, 50)
POLICY_COLOURS = {"risk": BLUE, "paper": AMBER, "oracle": GREEN}


def psnr_curve(seconds: Float[np.ndarray, " k"], psnr: Float[np.ndarray, " k"]) -> Figure:
    """Training PSNR in dB against wall-clock time (CARFF Fig. 12)."""
    figure = new_figure(HALF_WIDTH, 4.0)
    axes = figure.subplots()
    minutes = seconds / 60
    axes.plot(minutes, psnr, color=BLUE, linewidth=2)
    axes.set_xlim(left=0)
    style_chart(axes, "PC-VAE reconstruction while training", "wall clock (minutes)", "PSNR (dB)")
    return figure


def latent_map(
    points: Float[np.ndarray, "n 2"],
    states: Int[np.ndarray, " n"],
    determined: Bool[np.ndarray, " n"],
    style: StateStyle,
) -> Figure:
    """Latents in the plane, coloured by state; crosses are views whose picture fits several states (CARFF Fig. 11)."""
    figure = new_figure(HALF_WIDTH, 4.0)
    axes = figure.subplots()
    for state, colour in enumerate(style.colours):
        own = states == state
        clear, open_ = points[own & determined], points[own & ~determined]
        axes.scatter(*clear.T, s=14, color=colour, linewidths=0.3, edgecolors=PAPER, label=style.names[state])
        axes.scatter(*open_.T, s=18, color=colour, marker="x", linewidths=0.9)
    axes.scatter([], [], s=18, color=MUTED, marker="x", linewidths=0.9, label="picture fits several states")
    style_chart(axes, "Latents of all views (t-SNE)")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.grid(visible=False)
    axes.spines[["left", "bottom"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=SMALL, handletextpad=0.2)
    return figure


def psnr_heatmap(
    matrix: Float[np.ndarray, "r s"],
    row_state: Int[np.ndarray, " r"],
    predicted: Bool[np.ndarray, " r"],
    equal: Bool[np.ndarray, "s s"],
    style: StateStyle,
    title: str,
) -> Figure:
    """PSNR against every ground truth: dB where the state is the row's own, the difference to it elsewhere (CARFF Table
    6).
    """
    rows, columns = matrix.shape
    figure = new_figure(HALF_WIDTH, 0.42 * rows + 1.3)
    axes = figure.subplots()
    own = matrix[np.arange(rows), row_state]
    finite_own = np.where(np.isfinite(own), own, np.nan)
    difference = matrix - finite_own[:, None]
    axes.imshow(difference, cmap="Blues", vmin=-4, vmax=0.7, aspect="auto")
    for row in range(rows):
        for column in range(columns):
            matched = equal[row_state[row], column]
            value = matrix[row, column] if matched else difference[row, column]
            axes.text(
                column,
                row,
                _decibels(value, signed=not matched),
                ha="center",
                va="center",
                fontsize=SMALL + (0 if columns > 8 else 1),
                fontweight="bold" if matched else "normal",
                color=PAPER if matched or difference[row, column] > -1.1 else INK,
            )
    axes.set_xticks(
        range(columns), style.names, rotation=30 if columns > 4 else 0, ha="right" if columns > 4 else "center"
    )
    kinds = ["predicted" if flag else "toggled" for flag in predicted]
    axes.set_yticks(range(rows), [f"{kind}  {style.name(state)}" for kind, state in zip(kinds, row_state.tolist())])
    style_chart(axes, title, "ground truth")
    axes.grid(visible=False)
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)
    return figure


def confusion_heatmap(
    counts: Int[np.ndarray, "rows answers"], row_names: Sequence[str], answer_names: Sequence[str], title: str
) -> Figure:
    """How often each answer was given for each truth, as counts on a row-normalised shade."""
    rows, answers = counts.shape
    figure = new_figure(HALF_WIDTH, 0.42 * rows + 1.3)
    axes = figure.subplots()
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.imshow(share, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for row in range(rows):
        for column in range(answers):
            if counts[row, column]:
                ink = PAPER if share[row, column] > 0.5 else INK
                axes.text(column, row, counts[row, column], ha="center", va="center", fontsize=SMALL + 0.5, color=ink)
    axes.set_xticks(range(answers), answer_names, rotation=30, ha="right")
    axes.set_yticks(range(rows), row_names)
    style_chart(axes, title, "answer", "truth")
    axes.grid(visible=False)
    axes.tick_params(length=0)
    return figure


def accuracy_recall_chart(curves: AccuracyRecall, title: str) -> Figure:
    """Accuracy and recall against the number of samples with confidence bands and closed forms (CARFF Fig. 8, 13)."""
    figure = new_figure(FULL_WIDTH, 3.2)
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, lines in (
        (left, ((curves.accuracy, BLUE, "accuracy"), (curves.all_correct, VERMILION, "all n samples right"))),
        (right, ((curves.recall, GREEN, "recall"),)),
    ):
        drawn = [_curve(axes, curve, colour, name) for curve, colour, name in lines if curve is not None]
        axes.set_xticks(SHOWN_DRAWS)
        if drawn:
            axes.plot([], [], color=MUTED, linewidth=1, linestyle=(0, (4, 2)), label="closed form, independent draws")
            axes.legend(frameon=False, fontsize=SMALL + 0.5, loc="lower right")
        else:
            axes.text(0.5, 0.5, "no image of this kind in the data", transform=axes.transAxes, ha="center", color=MUTED)
        axes.set_ylim(0, 1.04)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
    style_chart(left, f"{title}: pictures with one answer", "samples n")
    style_chart(right, f"{title}: pictures with several answers", "samples n")
    return figure


def calibration_chart(calibration: Mapping) -> Figure:
    """Predicted probability of a branch against its true frequency, one panel per visibility class."""
    figure = new_figure(FULL_WIDTH, 3.9)
    panels = figure.subplots(1, len(VISIBILITY_CLASSES), sharey=True)
    for axes, name, colour in zip(panels, VISIBILITY_CLASSES, VISIBILITY_COLOURS):
        table = calibration["by_visibility"][name]
        axes.plot([0, 1], [0, 1], color=MUTED, linewidth=1, linestyle=(0, (4, 3)))
        bins = table["bins"]
        if bins:
            counts = np.array([row["count"] for row in bins])
            axes.scatter(
                [row["probability"] for row in bins],
                [row["frequency"] for row in bins],
                s=25 + 350 * counts / counts.sum(),
                color=colour,
                alpha=0.85,
                edgecolors=INK,
                linewidths=0.6,
            )
            note = f"ECE {table['ece']:.3f}\n{table['views']} views"
        else:
            note = "no such view"
        axes.text(0.04, 0.96, note, transform=axes.transAxes, va="top", fontsize=NORMAL, color=INK)
        style_chart(axes, f"actor visibility: {name}", "predicted probability")
        axes.set_xlim(-0.05, 1.05)
        axes.set_ylim(-0.05, 1.05)
        axes.set_aspect("equal")
    panels[0].set_ylabel("true frequency", fontsize=NORMAL)
    return figure


def planning_chart(rows: Sequence[PlanRow], paper: Mapping[tuple[str, int | None], tuple[float, float]]) -> Figure:
    """Success at a hazard and with a clear way, with 95 % intervals; hollow diamonds are the paper's rates (CARFF Table
    3).
    """
    figure = new_figure(FULL_WIDTH, 0.34 * len(rows) + 1.0)
    panels = figure.subplots(1, 2, sharey=True)
    places = range(len(rows))[::-1]
    for side, (axes, title) in enumerate(zip(panels, ("hazard: waits", "clear: goes"))):
        for place, row in zip(places, rows):
            value = (row.hazard, row.clear)[side]
            _interval_dot(axes, place, value.share, (value.low, value.high), POLICY_COLOURS.get(row.rule, MUTED))
            if (row.rule, row.n) in paper:
                reference = paper[(row.rule, row.n)][side]
                axes.plot(reference, place, marker="D", markersize=8, mfc="none", mec=INK, mew=0.9, zorder=4)
        _percent_axis(axes)
        style_chart(axes, title, "decisions that were right")
    panels[0].set_yticks(places, [policy_label(row.rule, row.n) for row in rows])
    panels[0].set_ylim(-0.6, len(rows) - 0.4)
    return figure


def closed_loop_chart(policies: Mapping[str, Mapping]) -> Figure:
    """Collisions, needless stops and time to cross of every policy, with 95 % intervals or quartiles."""
    figure = new_figure(FULL_WIDTH, 0.4 * len(policies) + 1.0)
    panels = figure.subplots(1, 3, sharey=True)
    places = range(len(policies))[::-1]
    for place, (name, row) in zip(places, policies.items()):
        colour = POLICY_COLOURS.get(name, MUTED)
        _interval_dot(panels[0], place, row["collision_rate"], row["collision_interval"], colour)
        _interval_dot(panels[1], place, row["needless_stop_rate"], row["needless_stop_interval"], colour)
        quartiles = row["time_to_cross_quartiles_s"]
        if quartiles is None:
            panels[2].text(
                0.03, place, "never crosses", transform=panels[2].get_yaxis_transform(), va="center", color=MUTED
            )
        else:
            _interval_dot(panels[2], place, quartiles[1], (quartiles[0], quartiles[2]), colour)
    for axes in panels[:2]:
        _percent_axis(axes)
    panels[2].set_xlim(left=0)
    style_chart(panels[0], "collisions", "of all episodes")
    style_chart(panels[1], "needless stops", "of the episodes with a clear way")
    style_chart(panels[2], "time to cross", "seconds (median and quartiles)")
    panels[0].set_yticks(places, [policy_label(name) for name in policies])
    panels[0].set_ylim(-0.6, len(policies) - 0.4)
    return figure


def _curve(axes: Axes, curve: Curve, colour: str, name: str) -> None:
    n = np.arange(1, len(curve.mean) + 1)
    axes.fill_between(n, curve.low, curve.high, color=colour, alpha=0.18, linewidth=0)
    axes.plot(n, curve.mean, color=colour, linewidth=2, label=f"{name} ({curve.images} images)")
    axes.plot(n, curve.closed_form, color=colour, linewidth=1, linestyle=(0, (4, 2)))


def _interval_dot(axes: Axes, place: int, value: float | None, interval: Sequence | None, colour: str) -> None:
    if value is None or interval is None:
        axes.text(
            0.03, place, "no such case", transform=axes.get_yaxis_transform(), va="center", color=MUTED, fontsize=SMALL
        )
        return
    axes.plot(interval, [place, place], color=colour, linewidth=5, alpha=0.3, solid_capstyle="round")
    axes.plot(value, place, marker="o", markersize=7, color=colour, zorder=3)


def _percent_axis(axes: Axes) -> None:
    axes.set_xticks([0, 0.25, 0.5, 0.75, 1])
    axes.xaxis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
    axes.set_xlim(-0.05, 1.05)


def _decibels(value: float, signed: bool) -> str:
    if not np.isfinite(value):
        return "identical" if value > 0 else ""
    return (f"{value:+.1f}" if signed else f"{value:.1f}").replace("-", "−")
