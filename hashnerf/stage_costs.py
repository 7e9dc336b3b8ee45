"""What the stages of a run cost, as a chart and as a table: wall-clock seconds, and the largest resident size of a
stage's process in MB. Stages that ran side by side (`within` a phase, see `hashnerf.pipeline`) are details of it.
"""

import resource
import sys
from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from hashnerf.figure_style import BLUE, FULL_WIDTH, MUTED, SKY, SMALL, new_figure, style_chart
from hashnerf.report_tables import DASH, Table, number

DETAIL = "· "
"""Before the name of a stage that ran within a phase."""


def ordered_stages(timed: Mapping[str, Mapping]) -> list[dict]:
    """Returns timings as a list with names, each phase followed by its members."""
    stages = []
    for name, cost in timed.items():
        if cost.get("within") not in timed:
            stages.append({"name": name, **cost})
            stages += [{"name": member, **own} for member, own in timed.items() if own.get("within") == name]
    return stages


def stages_chart(stages: Sequence[Mapping]) -> Figure:
    """Wall-clock time and peak memory of every stage (`name`, `seconds`, `peak_memory_mb`), in the order they ran."""
    figure = new_figure(FULL_WIDTH, 0.32 * len(stages) + 0.9)
    panels = figure.subplots(1, 2, sharey=True)
    places = range(len(stages))[::-1]
    for axes, key, colour, unit in ((panels[0], "seconds", BLUE, "s"), (panels[1], "peak_memory_mb", MUTED, "MB")):
        values = [stage[key] or 0.0 for stage in stages]
        shades = [SKY if colour == BLUE and "within" in stage else colour for stage in stages]
        axes.barh(places, values, color=shades, height=0.6)
        for place, value in zip(places, values):
            axes.text(
                value, place, f"  {value:,.0f} {unit}" if value else "  not measured", va="center", fontsize=SMALL
            )
        axes.set_xlim(0, 1.2 * max([*values, 1.0]))
        axes.grid(visible=False, axis="y")
    style_chart(panels[0], "wall clock", "seconds")
    style_chart(panels[1], "peak memory", "MB")
    panels[0].set_yticks(places, [_label(stage) for stage in stages])
    return figure


def cost_tables(results: Mapping) -> list[Table]:
    """Time and memory of every stage."""
    rows = tuple(
        (_label(stage), number(stage["seconds"], "s"), number(stage["peak_memory_mb"], "MB", 0))
        for stage in results.get("stages", ())
    )
    total = ((results.get("seconds_cover", "total"), number(results.get("seconds_total"), "s"), DASH),)
    return [Table(("stage", "wall clock", "peak memory"), rows + total)]


def peak_memory_mb() -> float:
    """The largest resident size of this process so far."""
    unit = 1e6 if sys.platform == "darwin" else 1e3  # bytes on macOS, kilobytes elsewhere
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def _label(stage: Mapping) -> str:
    return f"{DETAIL}{stage['name']}" if "within" in stage else stage["name"]
