"""Figures of drives: paths over the map, and errors along the path.

A drive is a mapping with `trajectory`, `method`, `track` [[x, y], ...] (m), `lateral` (m) and `heading` (rad) of every
moment, and `put_back` [[x, y], ...], the places of interventions. Every function returns a matplotlib figure.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from aerial2ground.map_chart import draw_map
from aerial2ground.paths import Path
from aerial2ground.report_words import COLOURS, DRIVERS
from aerial2ground.road_network import RoadNetwork
from hashnerf.figure_style import FULL_WIDTH, INK, MUTED, PAPER, SMALL, new_figure, style_chart

BIN = 0.25
"""Metres of path that share one point of an error curve."""
DASHES = {"expert": (0, (1, 1)), "imit": (0, (4, 1.5)), "imit_gv": (0, (6, 1, 1, 1)), "ours": "-", "ours_gv": "-"}


def driven_paths(
    paths: Mapping[str, Sequence], drives: Sequence[Mapping], network: RoadNetwork | None = None
) -> Figure:
    """Every drive over the roads, one panel a trajectory; crosses are interventions."""
    figure = new_figure(FULL_WIDTH, 3.2 * -(-len(paths) // 3) + 0.4)
    columns = min(len(paths), 3)
    panels = list(figure.subplots(-(-len(paths) // columns), columns, squeeze=False).flat)
    for axes, (name, points) in zip(panels, paths.items()):
        line = np.array(points, dtype=float)
        own = [drive for drive in drives if drive["trajectory"] == name]
        draw_map(axes, network, [line, *(np.array(drive["track"], dtype=float) for drive in own)], _plain(name))
        for method in DRIVERS:
            for drive in (drive for drive in own if drive["method"] == method):
                track = np.array(drive["track"], dtype=float)
                axes.plot(*track.T, color=COLOURS[method], linewidth=1.1, alpha=0.85, zorder=2)
                back = np.array(drive.get("put_back", ()), dtype=float).reshape(-1, 2)
                axes.scatter(*back.T, marker="X", s=42, color=COLOURS[method], edgecolor=PAPER, linewidth=0.6, zorder=5)
        axes.plot(*line.T, color=INK, linewidth=0.8, linestyle=(0, (3, 3)), zorder=3)
    for axes in panels[len(paths) :]:
        axes.axis("off")
    _legend(figure, drives, cross=True, solid=True)
    return figure


def path_errors(paths: Mapping[str, Sequence], drives: Sequence[Mapping], limit: float) -> Figure:
    """Root mean square lateral and heading error at every place of a path; `limit` (m) is where somebody intervenes."""
    figure = new_figure(FULL_WIDTH, 4.6)
    panels = figure.subplots(2, len(paths), squeeze=False, sharey="row", sharex="col")
    for column, (name, points) in zip(panels.T, paths.items()):
        path = Path(np.array(points, dtype=float))
        for method in DRIVERS:
            own = [drive for drive in drives if (drive["trajectory"], drive["method"]) == (name, method)]
            if own:
                _error_curves(list(column), path, own, method)
        column[0].axhline(100 * limit, color=MUTED, linewidth=1)
        style_chart(column[0], _plain(name), "", "lateral error (cm)" if column is panels.T[0] else "")
        style_chart(column[1], "", "metres along the path", "")
        column[0].set_xlim(0, path.length)
    panels[0, 0].set_ylabel("lateral error (cm)", fontsize=SMALL + 1)
    panels[1, 0].set_ylabel("heading error (deg)", fontsize=SMALL + 1)
    for axes in panels[:, 0]:
        axes.set_ylim(bottom=0)
    _legend(figure, drives)
    return figure


def rms_along(
    path: Path, drives: Sequence[Mapping]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Returns places (m), lateral RMS (m) and heading RMS (rad) over all drives; NaN where nobody was."""
    bins = max(round(path.length / BIN), 1)
    track = np.concatenate([np.array(drive["track"], dtype=float) for drive in drives])
    errors = np.stack([np.concatenate([np.array(drive[key]) for drive in drives]) for key in ("lateral", "heading")])
    arc = np.array([path.nearest(point)[0] for point in track])
    index = np.minimum((arc / path.length * bins).astype(int), bins - 1)
    count = np.bincount(index, minlength=bins)
    squares = np.stack([np.bincount(index, weights=error**2, minlength=bins) for error in errors])
    rms = np.sqrt(np.divide(squares, count, out=np.full(squares.shape, np.nan), where=count > 0))
    return (np.arange(bins) + 0.5) * path.length / bins, rms[0], rms[1]


def _error_curves(column: Sequence[Axes], path: Path, drives: Sequence[Mapping], method: str) -> None:
    places, lateral, heading = rms_along(path, drives)
    for axes, values in zip(column, (100 * lateral, np.degrees(heading))):
        axes.plot(
            places,
            values,
            color=COLOURS[method],
            linestyle=DASHES[method],
            linewidth=2 if method == "ours" else 1.4,
            zorder=3 if method == "ours" else 2,
        )


def _legend(figure: Figure, drives: Sequence[Mapping], cross: bool = False, solid: bool = False) -> None:
    drove = {drive["method"] for drive in drives}
    entries = [
        Line2D([], [], color=COLOURS[method], linewidth=2, linestyle="-" if solid else DASHES[method], label=label)
        for method, label in DRIVERS.items()
        if method in drove
    ]
    if cross:
        entries.append(
            Line2D([], [], color=INK, linewidth=0.8, linestyle=(0, (3, 3)), label="path to follow"),
        )
        entries.append(Line2D([], [], color=MUTED, marker="X", linestyle="", markersize=6, label="intervention"))
    figure.legend(handles=entries, loc="outside lower center", ncols=len(entries), frameon=False, fontsize=SMALL + 0.5)


def _plain(name: str) -> str:
    return name.replace("_", " ")
