"""The figure of decisions along the ego's approach: what is expected at every place, state by state."""

from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from carff.state_style import ABSENT_COLOUR, StateStyle
from hashnerf.figure_style import AMBER, FULL_WIDTH, GREEN, VERMILION, frame_legend, new_figure, style_chart

KIND_COLOURS = {"hidden": AMBER, "shown": VERMILION, "clear": GREEN, "other": ABSENT_COLOUR}
KIND_LABELS = {
    "hidden": "hides a hazard: wait",
    "shown": "shows a hazard: wait",
    "clear": "clear: go",
    "other": "no single right decision",
}


def approach_chart(points: Sequence[Mapping], style: StateStyle, states: Sequence[tuple[int, int]]) -> Figure:
    """Share of hazardous futures against the way to the stop line, a panel per state; crosses are wrong decisions."""
    own = {state: [point for point in points if (point["branch"], point["step"]) == state] for state in states}
    drawn = [(style.names[number], own[state]) for number, state in enumerate(states) if own[state]]
    rows = max(-(-len(drawn) // 2), 1)
    figure = new_figure(FULL_WIDTH, 1.8 * rows + 0.6)
    panels = list(figure.subplots(rows, 2, sharex=True, sharey=True, squeeze=False).flat)
    for axes, (name, of_state) in zip(panels, drawn):
        _draw(axes, of_state)
        style_chart(axes, name, "", "hazardous futures")
    for axes in panels[len(drawn) :]:
        axes.axis("off")
    if drawn:
        panels[0].set_ylim(-0.06, 1.06)
        panels[0].invert_xaxis()  # the ego drives to the right
        panels[0].yaxis.set_major_formatter(PercentFormatter(1))
        for axes in panels[max(len(drawn) - 2, 0) : len(drawn)]:
            axes.xaxis.label.set_text("metres to the stop line")
    frame_legend(figure, [(KIND_LABELS[kind], colour) for kind, colour in KIND_COLOURS.items()])
    return figure


def _draw(axes: Axes, points: Sequence[Mapping]) -> None:
    for kind, colour in KIND_COLOURS.items():
        for wrong in (False, True):
            chosen = [point for point in points if point["kind"] == kind and _is_wrong(point) == wrong]
            places, shares = [point["to_line"] for point in chosen], [point["hazard_share"] for point in chosen]
            axes.scatter(places, shares, s=60 if wrong else 10, marker="x" if wrong else "o", color=colour)


def _is_wrong(point: Mapping) -> bool:
    return point["kind"] != "other" and point["go"] != (point["kind"] == "clear")
