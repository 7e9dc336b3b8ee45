"""Tables I and II as pictures: means as dots with their spread, and the paper's figures as hollow diamonds."""

from collections.abc import Callable, Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from aerial2ground.report_words import COLOURS, DRIVERS, LOCATORS, paper_drive, paper_place
from hashnerf.figure_style import FULL_WIDTH, GRID, INK, MUTED, SMALL, new_figure, style_chart

Paper = Callable[[int, str, str], Sequence[float] | None]
"""Given the number and name of a row's group, and its method: the paper's figures."""


def table_one_chart(table: Mapping[str, Mapping]) -> Figure:
    """Position and yaw error of every method in every arrangement of the houses."""
    columns = (("pos_m", "position RMSE (m)"), ("yaw_deg", "yaw RMSE (deg)"))
    return _chart(table, LOCATORS, columns, lambda number, town, method: paper_place(town, method))


def table_two_chart(table: Mapping[str, Mapping]) -> Figure:
    """Position error, yaw error and interventions of every method on every trajectory."""
    columns = (
        ("pos_m", "position RMSE (m)"),
        ("yaw_deg", "yaw RMSE (deg)"),
        ("interventions", "interventions a run"),
    )
    return _chart(table, DRIVERS, columns, lambda number, path, method: paper_drive(number, method))


def _chart(
    table: Mapping[str, Mapping], methods: Mapping[str, str], columns: Sequence[tuple[str, str]], paper: Paper
) -> Figure:
    lines = [
        (number, group, method)
        for number, (group, rows) in enumerate(table.items())
        for method in methods
        if method in rows
    ]
    places = [-line - 0.7 * number for line, (number, _, _) in enumerate(lines)]
    figure = new_figure(FULL_WIDTH, 0.22 * (len(lines) + 0.7 * len(table)) + 1.1)
    panels = figure.subplots(1, len(columns), sharey=True, squeeze=False)[0]
    for column, (axes, (key, label)) in enumerate(zip(panels, columns)):
        for place, (number, group, method) in zip(places, lines):
            _dot(axes, place, table[group][method], key, COLOURS[method])
            told = paper(number, group, method)
            if told is not None:
                axes.plot(told[column], place, marker="D", markersize=5, markerfacecolor="none", color=MUTED, zorder=2)
        style_chart(axes, "", label)
        axes.set_xlim(left=-0.02 * axes.get_xlim()[1])
        axes.grid(visible=False, axis="y")
    panels[0].set_yticks(places, [f"{group.replace('_', ' ')}: {methods[method]}" for _, group, method in lines])
    entries = [
        Line2D([], [], color=INK, marker="o", linewidth=3, alpha=0.6, markersize=6, label="here: mean and deviation"),
        Line2D([], [], color=MUTED, marker="D", linestyle="", markerfacecolor="none", label="the paper, own data"),
    ]
    figure.legend(handles=entries, loc="outside lower center", ncols=2, frameon=False, fontsize=SMALL + 0.5)
    return figure


def _dot(axes: Axes, place: float, row: Mapping, key: str, colour: str) -> None:
    axes.axhline(place, color=GRID, linewidth=0.6, zorder=0)
    if row.get(key) is None:
        return
    around = row.get(f"{key}_spread") or 0.0
    ends = [max(row[key] - around, 0.0), row[key] + around]
    axes.plot(ends, [place, place], color=colour, linewidth=5, alpha=0.35, solid_capstyle="butt", zorder=2)
    axes.plot(row[key], place, marker="o", markersize=6.5, color=colour, zorder=3)
