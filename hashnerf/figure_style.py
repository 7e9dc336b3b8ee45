"""One look for every figure of a report: canvas, type sizes and colours.

Hues come from the palette of Okabe and Ito, which people with any common form of colour blindness can tell apart; no
figure relies on colour alone. Figures are drawn by the Agg canvas without the stateful pyplot interface, so no display
is needed and threads do not share anything. Sizes are in inches.
"""

import io
from collections.abc import Sequence

import numpy as np
from jaxtyping import Shaped
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hashnerf.unit_pictures import unit_pictures

FULL_WIDTH = 10.0
HALF_WIDTH = 5.2
DPI = 140
SMALL, NORMAL = 7.5, 9.0
INK, MUTED, GRID, PAPER = "#222222", "#6B6B6B", "#DDDDDD", "#FFFFFF"
BLUE, VERMILION, GREEN, PURPLE, AMBER, SKY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"


def new_figure(width: float, height: float) -> Figure:
    """An empty white figure of that size in inches with the Agg canvas."""
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor=PAPER, layout="constrained")
    figure.get_layout_engine().set(w_pad=0.06, h_pad=0.04)
    FigureCanvasAgg(figure)
    return figure


def png_bytes(figure: Figure) -> bytes:
    """The figure as a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    return buffer.getvalue()


def style_chart(axes: Axes, title: str = "", xlabel: str = "", ylabel: str = "") -> None:
    """Sober chart: no box, light grid behind the data, left-aligned title."""
    axes.set_title(title, fontsize=NORMAL, color=INK, loc="left", fontweight="bold")
    axes.set_xlabel(xlabel, fontsize=NORMAL, color=INK)
    axes.set_ylabel(ylabel, fontsize=NORMAL, color=INK)
    axes.tick_params(labelsize=SMALL + 0.5, colors=MUTED, length=3)
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(MUTED)


def show_picture(
    axes: Axes,
    picture: Shaped[np.ndarray, "h w 3"],
    title: str = "",
    frame: str | None = None,
    dashed: bool = False,
    title_colour: str = INK,
) -> None:
    """Draws a picture without axes, with an optional coloured frame and a small title above."""
    axes.imshow(unit_pictures(picture).clip(0, 1), interpolation="antialiased", aspect="equal")
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(frame is not None)
        spine.set_edgecolor(frame or INK)
        spine.set_linewidth(2.4)
        spine.set_linestyle((0, (2, 1.5)) if dashed else "solid")
    if title:
        axes.set_title(title, fontsize=SMALL, color=title_colour, pad=3)


def hide(axes: Axes) -> None:
    """Leaves the place of an unused cell empty."""
    axes.axis("off")


def frame_legend(figure: Figure, entries: Sequence[tuple[str, str]]) -> None:
    """A legend of (name, colour) frames along the lower edge of the figure."""
    handles = [
        Line2D([], [], marker="s", linestyle="", markersize=8, markerfacecolor="none", markeredgewidth=2, color=colour)
        for _, colour in entries
    ]
    figure.legend(
        handles,
        [name for name, _ in entries],
        loc="outside lower center",
        ncols=len(entries),
        frameon=False,
        fontsize=SMALL + 0.5,
        labelcolor=INK,
    )
