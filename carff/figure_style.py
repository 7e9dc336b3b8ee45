"""One look for every figure of a report: canvas, type sizes, and colours that mean the same thing everywhere.

A *state* has one colour in all figures: its hue says the branch, its darkness the step (light = early). Data with a
single branch uses one sequential scale over the steps instead. Hues and visibility colours come from the palette of
Okabe and Ito, which people with any common form of colour blindness can tell apart; no figure relies on colour alone.
Figures are drawn by the Agg canvas without the stateful pyplot interface, so no display is needed and threads do not
share anything. Sizes are in inches.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Shaped
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from carff.scene_metrics import unit_pictures

FULL_WIDTH = 10.0
HALF_WIDTH = 5.2
DPI = 140
SMALL, NORMAL = 7.5, 9.0
INK, MUTED, GRID, PAPER = "#222222", "#6B6B6B", "#DDDDDD", "#FFFFFF"
BLUE, VERMILION, GREEN, PURPLE, AMBER, SKY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
BRANCH_HUES = (BLUE, VERMILION, GREEN, PURPLE, AMBER, SKY)
UNKNOWN_COLOUR = "#111111"
# In the order of forecast_metrics.VISIBILITY_CLASSES: none, partial, full.
VISIBILITY_COLOURS = (VERMILION, AMBER, GREEN)
ABSENT_COLOUR = "#C8C8C8"


@dataclass(frozen=True)
class StateStyle:
    """How the states of a scene are named and coloured, by state index; index -1 is the unknown state."""

    names: tuple[str, ...]
    colours: tuple[str, ...]

    def name(self, state: int) -> str:
        """The state's short name; `unknown` for any index that is no state."""
        return self.names[state] if 0 <= state < len(self.names) else "unknown"

    def colour(self, state: int) -> str:
        """The state's colour; near-black for any index that is no state."""
        return self.colours[state] if 0 <= state < len(self.colours) else UNKNOWN_COLOUR


def state_style(states: Sequence[tuple[int, int]], branch_names: Sequence[str] = ()) -> StateStyle:
    """Names such as `present t2` and colours of states given as (branch, step); nameless branches get a letter."""
    branches, steps = sorted({branch for branch, _ in states}), sorted({step for _, step in states})
    names, colours = [], []
    for branch, step in states:
        depth = steps.index(step) / max(len(steps) - 1, 1)
        if len(branches) == 1:
            names.append(f"t{step}")
            colours.append(to_hex(colormaps["viridis"](0.95 - 0.9 * depth)))
        else:
            letter = chr(ord("A") + branch % 26)
            name = branch_names[branch] if branch < len(branch_names) else letter
            names.append(f"{name} t{step}")
            colours.append(_shade(BRANCH_HUES[branches.index(branch) % len(BRANCH_HUES)], depth))
    return StateStyle(tuple(names), tuple(colours))


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


def _shade(colour: str, depth: float) -> str:
    """The hue mixed with white for depth 0 and with black for depth 1."""
    rgb = np.array(to_rgb(colour))
    mixed = rgb + (1 - rgb) * (0.5 - depth) if depth < 0.5 else rgb * (1 - 0.75 * (depth - 0.5))
    return to_hex(mixed)
