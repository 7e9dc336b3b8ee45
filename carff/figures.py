"""Figures made of pictures: what the data shows, what the decoder reconstructs, which futures are sampled.

Pictures are uint8 or float in [0, 1], [h, w, 3]; states are integer indices into a `StateStyle`. Every function returns
a matplotlib figure; `figure_style.png_bytes` turns it into a file.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Shaped
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpecBase, SubplotSpec

from carff.forecast_metrics import VISIBILITY_CLASSES
from carff.scene_metrics import psnr_db
from carff.state_style import ABSENT_COLOUR, VISIBILITY_COLOURS, StateStyle
from hashnerf.figure_style import (
    FULL_WIDTH,
    INK,
    MUTED,
    NORMAL,
    PAPER,
    SMALL,
    frame_legend,
    hide,
    new_figure,
    show_picture,
    style_chart,
)
from hashnerf.unit_pictures import unit_pictures


@dataclass(frozen=True)
class ReconstructionRow:
    """One encoded image and what the decoder makes of its belief (CARFF Fig. 9)."""

    encoded: Shaped[np.ndarray, "h w 3"]
    encoded_state: int
    title: str
    truths: Shaped[np.ndarray, "s h w 3"]
    """Ground truth of every state at the encoder's own camera."""
    targets: Shaped[np.ndarray, "k h w 3"]
    """Ground truth of the encoded state at other cameras."""
    decoded: Shaped[np.ndarray, "k h w 3"]
    """The decoder's pictures at those cameras."""
    target_names: tuple[str, ...]


@dataclass(frozen=True)
class Futures:
    """One image, the futures that may truly follow it and the futures sampled from its forecast; `v` views each."""

    image: Shaped[np.ndarray, "h w 3"]
    title: str
    view_names: tuple[str, ...]
    true_states: tuple[int, ...]
    true_probability: tuple[float, ...]
    true_pictures: Shaped[np.ndarray, "t v hv wv 3"]
    sampled_states: tuple[int, ...]
    """State the probe found in every shown sample, -1 = unknown."""
    sampled_pictures: Shaped[np.ndarray, "n v hv wv 3"]
    mixture_weights: tuple[float, ...]
    state_probability: tuple[float, ...]
    """Predicted probability of every state and, last, of the unknown state."""
    draws: int
    """Samples that `state_probability` was counted from."""


def contact_sheet(
    pictures: Shaped[np.ndarray, "s c h w 3"],
    style: StateStyle,
    cameras: Sequence[str],
    visibility: Int[np.ndarray, "s c"] | None = None,
    share: Float[np.ndarray, "s c"] | None = None,
) -> Figure:
    """States by cameras, framed by what each view shows of the actor.

    `visibility` indexes VISIBILITY_CLASSES, -1 = actor absent; `share` is the visible share of the actor's pixels in
    [0, 1].
    """
    states, columns, height, width = pictures.shape[:4]
    cell = (FULL_WIDTH - 0.9) / columns
    figure = new_figure(FULL_WIDTH, states * cell * height / width + 0.8)
    grid = figure.subplots(states, columns, squeeze=False)
    for state, row in enumerate(grid):
        for column, axes in enumerate(row):
            known = visibility is not None and visibility[state, column] >= 0
            colour = VISIBILITY_COLOURS[visibility[state, column]] if known else ABSENT_COLOUR
            show_picture(axes, pictures[state, column], frame=colour)
            if state == 0:
                axes.set_title(cameras[column], fontsize=SMALL, color=INK)
            if column == 0:
                axes.set_ylabel(style.names[state], fontsize=NORMAL, color=INK, rotation=0, ha="right", va="center")
            if known and share is not None:
                _corner_note(axes, f"{100 * share[state, column]:.0f} %")
    if visibility is not None:
        seen = [(f"actor visibility: {name}", colour) for name, colour in zip(VISIBILITY_CLASSES, VISIBILITY_COLOURS)]
        frame_legend(figure, [*seen, ("no actor in this state", ABSENT_COLOUR)])
    return figure


def reconstruction_grid(rows: Sequence[ReconstructionRow], style: StateStyle) -> Figure:
    """Encoder input, ground truth of every state at that camera, and decoded pictures under their truths (CARFF Fig.
    9).
    """
    across, targets = -(-len(style.names) // 2), len(rows[0].targets)
    unit = FULL_WIDTH / (2 + across + targets)
    figure = new_figure(FULL_WIDTH, len(rows) * (2 * unit + 0.55))
    blocks = figure.add_gridspec(len(rows), 3, width_ratios=[2, across, targets])
    for row, place in zip(rows, range(len(rows))):
        show_picture(
            figure.add_subplot(blocks[place, 0]),
            row.encoded,
            f"encoder input\n{row.title}",
            frame=style.colour(row.encoded_state),
        )
        _truth_block(figure, blocks[place, 1], row, style, across)
        _decoded_block(figure, blocks[place, 2], row)
    return figure


def futures_strip(futures: Futures, style: StateStyle) -> Figure:
    """One image in, its true and sampled futures out, with the mixture behind them (CARFF Fig. 2, 6)."""
    views, true, samples = len(futures.view_names), len(futures.true_states), len(futures.sampled_states)
    # Columns in units of one small picture: the input (as wide as it is high), a gap, the truths, a gap, the samples.
    widths = [views, 0.15, *[1] * true, 0.1, *[1] * samples]
    pictures = views * FULL_WIDTH / sum(widths) + 0.45
    figure = new_figure(FULL_WIDTH, pictures + 1.8)
    outer = figure.add_gridspec(2, 1, height_ratios=[pictures, 1.8])
    grid = outer[0].subgridspec(views, len(widths), width_ratios=widths)
    show_picture(figure.add_subplot(grid[:, 0]), futures.image, f"input image\n{futures.title}")
    for column, (state, chance) in enumerate(zip(futures.true_states, futures.true_probability)):
        title = f"truth: {style.name(state)}\nfrequency {chance:.2f}"
        axes = _stack(figure, grid, 2 + column, futures.true_pictures[column], title, style, state)
        if column == 0:
            for place, name in zip(axes, futures.view_names):
                place.set_ylabel(name, fontsize=SMALL, color=MUTED)
    for column, state in enumerate(futures.sampled_states):
        title = f"sample {column + 1}\n{style.name(state)}"
        _stack(figure, grid, 3 + true + column, futures.sampled_pictures[column], title, style, state)
    _probability_panels(figure, outer[1], futures, style)
    return figure


def _stack(
    figure: Figure, grid: GridSpecBase, column: int, pictures: np.ndarray, title: str, style: StateStyle, state: int
):
    """The views of one future under each other, framed in the colour of its state."""
    places = [figure.add_subplot(grid[view, column]) for view in range(len(pictures))]
    for place, picture in zip(places, pictures):
        show_picture(place, picture, frame=style.colour(state), dashed=state < 0)
    places[0].set_title(title, fontsize=SMALL, color=INK, pad=3)
    return places


def _corner_note(axes: Axes, text: str) -> None:
    box = {"facecolor": INK, "alpha": 0.65, "edgecolor": "none", "pad": 1.5}
    axes.text(0.05, 0.06, text, transform=axes.transAxes, fontsize=SMALL - 0.5, color=PAPER, va="bottom", bbox=box)


def _truth_block(figure: Figure, place: SubplotSpec, row: ReconstructionRow, style: StateStyle, across: int) -> None:
    grid = place.subgridspec(2, across)
    for state in range(2 * across):
        axes = figure.add_subplot(grid[state // across, state % across])
        if state >= len(style.names):
            hide(axes)
            continue
        own = state == row.encoded_state
        show_picture(axes, row.truths[state], style.names[state], frame=style.colour(state) if own else None)


def _decoded_block(figure: Figure, place: SubplotSpec, row: ReconstructionRow) -> None:
    grid = place.subgridspec(2, len(row.targets))
    for column, (truth, decoded, name) in enumerate(zip(row.targets, row.decoded, row.target_names)):
        quality = float(psnr_db(((unit_pictures(truth) - unit_pictures(decoded)) ** 2).mean()))
        above, below = (figure.add_subplot(grid[line, column]) for line in range(2))
        show_picture(above, truth, name)
        show_picture(below, decoded, f"{quality:.1f} dB" if np.isfinite(quality) else "identical")
        if column == 0:
            above.set_ylabel("truth", fontsize=SMALL, color=MUTED)
            below.set_ylabel("decoded", fontsize=SMALL, color=MUTED)


def _probability_panels(figure: Figure, place: SubplotSpec, futures: Futures, style: StateStyle) -> None:
    panels = place.subgridspec(1, 2, width_ratios=[1, 3])
    weights = figure.add_subplot(panels[0])
    order = np.argsort(futures.mixture_weights)[::-1]
    weights.bar(range(len(order)), np.array(futures.mixture_weights)[order], color=MUTED, width=0.6)
    weights.set_xticks(range(len(order)), [f"k = {index + 1}" for index in range(len(order))])
    style_chart(weights, "mixture weights")
    chances = figure.add_subplot(panels[1])
    names = [*style.names, "unknown"]
    colours = [style.colour(state) for state in range(len(style.names))] + [style.colour(-1)]
    chances.bar(range(len(names)), futures.state_probability, color=colours, width=0.6)
    true = np.zeros(len(names))
    true[list(futures.true_states)] = futures.true_probability
    marks = {"linestyle": "", "marker": "_", "markersize": 30, "markeredgewidth": 2, "color": INK}
    chances.plot(futures.true_states, futures.true_probability, **marks)
    for index, value in enumerate(futures.state_probability):
        if value > 0:
            height = max(value, true[index]) + 0.04
            chances.text(index, height, f"{value:.2f}", ha="center", fontsize=SMALL, color=INK)
    chances.set_xticks(range(len(names)), names)
    style_chart(chances, f"probability of the next state, {futures.draws} samples (black line: true frequency)")
    for axes in (weights, chances):
        axes.set_ylim(0, 1.15)
        axes.grid(visible=False, axis="x")
