"""Figures of estimated poses: on the map, and how often an error is how large.

A track is a mapping with `trajectory`, `truth` and one list per method, all [[x, y, yaw], ...] in metres and radians.
Every function returns a matplotlib figure.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, PercentFormatter

from aerial2ground.map_chart import draw_map, draw_misses
from aerial2ground.report_words import COLOURS, LOCATORS
from aerial2ground.road_network import RoadNetwork
from hashnerf.figure_style import FULL_WIDTH, SMALL, new_figure, style_chart

DASHES = {"baseline": (0, (4, 1.5)), "ours": "-", "ours_imu": (0, (6, 1, 1, 1))}
SMALLEST = {"position": 0.003, "yaw": 0.1}
"""Left end of the axes: metres and degrees."""


def located_paths(tracks: Sequence[Mapping], network: RoadNetwork | None = None) -> Figure:
    """Estimates of every method over the roads, one line a trajectory, with thin lines to the truth."""
    shown = [method for method in LOCATORS if any(method in track for track in tracks)]
    figure = new_figure(FULL_WIDTH, 2.8 * len(tracks) + 0.2)
    panels = figure.subplots(len(tracks), max(len(shown), 1), squeeze=False)
    for row, track in zip(panels, tracks):
        truth = np.array(track["truth"], dtype=float)
        for axes, method in zip(row, shown):
            found = np.array(track.get(method, ()), dtype=float).reshape(-1, 3)
            title = f"{track['trajectory'].replace('_', ' ')}: {LOCATORS[method]}"
            draw_map(axes, network, [truth[:, :2]], title)
            if len(found):
                draw_misses(axes, truth, found, COLOURS[method])
                _name_far(axes, found)
            axes.set_xlabel("")
    return figure


def located_errors(towns: Mapping[str, Sequence[Mapping]]) -> Figure:
    """Share of estimates with at most some error, position above and yaw below, one column a town."""
    figure = new_figure(FULL_WIDTH, 4.8)
    panels = figure.subplots(2, len(towns), squeeze=False, sharey=True, sharex="row")
    for column, (town, tracks) in zip(panels.T, towns.items()):
        for method in LOCATORS:
            own = [track for track in tracks if method in track]
            if own:
                errors = [pose_errors(track["truth"], track[method]) for track in own]
                _share_below(column[0], np.concatenate([metres for metres, _ in errors]), method, SMALLEST["position"])
                _share_below(column[1], np.concatenate([degrees for _, degrees in errors]), method, SMALLEST["yaw"])
        style_chart(column[0], town.replace("_", " "), "position error (m)")
        style_chart(column[1], "", "yaw error (deg)")
    for row, name in zip(panels, ("position", "yaw")):
        row[0].set_ylabel("share of pictures", fontsize=SMALL + 1)
        row[0].yaxis.set_major_formatter(PercentFormatter(1.0))
        row[0].set_ylim(0, 1.02)
        row[0].set_xlim(left=SMALLEST[name])
        row[0].xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    entries = [
        Line2D([], [], color=COLOURS[method], linestyle=DASHES[method], linewidth=2, label=label)
        for method, label in LOCATORS.items()
    ]
    figure.legend(handles=entries, loc="outside lower center", ncols=3, frameon=False, fontsize=SMALL + 0.5)
    return figure


def pose_errors(truth: Sequence, found: Sequence) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Returns distances (m) and absolute yaw errors (deg) of estimates."""
    right, told = np.array(truth, dtype=float), np.array(found, dtype=float)
    turn = told[:, 2] - right[:, 2]
    return np.linalg.norm(told[:, :2] - right[:, :2], axis=1), np.degrees(abs(np.arctan2(np.sin(turn), np.cos(turn))))


def _name_far(axes: Axes, found: Float[np.ndarray, "n 3"]) -> None:
    """Says how many estimates lie outside what the map shows."""
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    inside = (found[:, 0] >= left) & (found[:, 0] <= right) & (found[:, 1] >= low) & (found[:, 1] <= high)
    if not inside.all():
        axes.text(0.98, 0.02, f"{(~inside).sum()} off the map", transform=axes.transAxes, ha="right", fontsize=SMALL)


def _share_below(axes: Axes, errors: Float[np.ndarray, " n"], method: str, smallest: float) -> None:
    ordered = np.sort(np.maximum(errors, smallest))
    shares = np.arange(1, len(ordered) + 1) / len(ordered)
    axes.semilogx(ordered, shares, color=COLOURS[method], linestyle=DASHES[method], linewidth=1.8)
    axes.plot(np.median(ordered), 0.5, marker="o", markersize=6, color=COLOURS[method], zorder=4)
