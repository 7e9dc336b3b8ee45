"""Maps: roads drawn at their width, and what happened on them. Positions are metres in the frame of the loaded data."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.patches import Circle, Polygon

from aerial2ground.road_network import RoadNetwork
from hashnerf.figure_style import INK, MUTED, NORMAL, SMALL

ASPHALT, MARKING = "#D6D8DB", "#FFFFFF"
MARGIN = 0.25
"""Metres around what is shown."""


def draw_map(axes: Axes, network: RoadNetwork | None, shown: Sequence[Float[np.ndarray, "_ 2"]], title: str) -> None:
    """Draws the roads, if they are known, and sets the limits so that they and the points `shown` are seen."""
    points = [np.asarray(part, dtype=float) for part in shown if len(part)]
    if network is not None:
        for line in network.lines:
            draw_road(axes, line.numpy().astype(float), network.width)
            points += [line.numpy() - network.width / 2, line.numpy() + network.width / 2]
    if points:
        low, high = np.concatenate(points).min(axis=0) - MARGIN, np.concatenate(points).max(axis=0) + MARGIN
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.set_title(title, fontsize=NORMAL, color=INK, loc="left", fontweight="bold")
    axes.tick_params(labelsize=SMALL, colors=MUTED, length=2)
    axes.set_xlabel("metres", fontsize=SMALL, color=MUTED)
    for spine in axes.spines.values():
        spine.set_visible(False)


def draw_road(axes: Axes, line: Float[np.ndarray, "n 2"], width: float) -> None:
    """Draws one road as a band of its width with a dashed centre line."""
    start, step = line[:-1], np.diff(line, axis=0)
    left = np.stack([-step[:, 1], step[:, 0]], axis=1) / np.linalg.norm(step, axis=1, keepdims=True) * width / 2
    ends = start + step
    patches = [Polygon(corners) for corners in np.stack([start + left, ends + left, ends - left, start - left], axis=1)]
    patches += [Circle(point, width / 2) for point in line]  # round joints and ends
    axes.add_collection(PatchCollection(patches, facecolor=ASPHALT, edgecolor="none", zorder=0))
    axes.plot(line[:, 0], line[:, 1], color=MARKING, linewidth=1, linestyle=(0, (5, 4)), zorder=0.5)


def draw_misses(
    axes: Axes, truth: Float[np.ndarray, "n _"], found: Float[np.ndarray, "n _"], colour: str, size: float = 7
) -> None:
    """Draws where the car truly was as a line, and every estimate as a dot with a thin line to the truth."""
    pairs = np.stack([truth[:, :2], found[:, :2]], axis=1)
    axes.add_collection(LineCollection(pairs, colors=colour, linewidths=0.7, alpha=0.45, zorder=2))
    axes.plot(truth[:, 0], truth[:, 1], color=INK, linewidth=1, zorder=3)
    axes.scatter(found[:, 0], found[:, 1], s=size, color=colour, linewidths=0, zorder=4)
