"""What happened on a drive, drawn from its black box: steering, speed, the age of pictures, and the guard's state."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.health import PICTURE_OLD, PICTURE_SLOW
from hashnerf.errors import UserError
from hashnerf.figure_style import (
    AMBER,
    BLUE,
    FULL_WIDTH,
    GREEN,
    INK,
    MUTED,
    PAPER,
    PURPLE,
    SMALL,
    VERMILION,
    new_figure,
    style_chart,
)

Values = Sequence[float] | Float[np.ndarray, " n"]
COLOURS = {"DISARMED": MUTED, "READY": AMBER, "ARMED": GREEN, "STOPPING": PURPLE, "FAULT": VERMILION}


def drive_chart(records: Sequence[Mapping]) -> Figure:
    """Returns the chart of a black box, as `replay.read_log` reads it; raises UserError for one without periods."""
    head, *cycles = records or [{}]
    if len(cycles) < 2:
        raise UserError("the black box holds no drive to be drawn; give that of a longer one")
    car, time = Actuation(**head["actuation"]), column(cycles, "t") - cycles[0]["t"]
    figure = new_figure(FULL_WIDTH, 6.0)
    panels = figure.subplots(4, 1, sharex=True, height_ratios=(3, 3, 2, 1))
    wanted = [cycle.get("wanted") or (np.nan, np.nan) for cycle in cycles]
    _draw(
        panels[0],
        time,
        "steering, rad\n(+ left)",
        {"wanted": [one[0] for one in wanted], "sent": column(cycles, "steering")},
    )
    speeds = {"wanted": [one[1] for one in wanted], "sent": column(cycles, "speed")}
    _draw(panels[1], time, "speed, m/s", speeds | {"measured": car.speed(1.0) * column(cycles, "erpm")})
    _draw(panels[2], time, "picture, ms old", {"age": 1000 * column(cycles, "picture_age")})
    for limit, what in ((PICTURE_SLOW, "slows down"), (PICTURE_OLD, "brakes")):
        panels[2].axhline(1000 * limit, color=MUTED, linewidth=0.7, linestyle=(0, (3, 3)))
        panels[2].annotate(what, (1, 1000 * limit), xycoords=("axes fraction", "data"), fontsize=SMALL, color=MUTED)
    panels[2].set_ylim(0, 1500 * PICTURE_OLD)
    _draw_states(panels[3], time, [cycle["state"] for cycle in cycles])
    for moment, cycle in zip(time, _first_of_each_fault(cycles), strict=True):
        if cycle:
            panels[1].axvline(moment, color=VERMILION, linewidth=1)
            panels[1].annotate(
                cycle, (moment, 0.04), xycoords=("data", "axes fraction"), fontsize=SMALL, color=VERMILION
            )
    return figure


def column(cycles: Sequence[Mapping], key: str) -> Float[np.ndarray, " periods"]:
    """Returns one number of every period; NaN where it was not known."""
    return np.array([np.nan if cycle.get(key) is None else cycle[key] for cycle in cycles], dtype=float)


def _draw(axes: Axes, time: Float[np.ndarray, " n"], label: str, lines: Mapping[str, Values]) -> None:
    style_chart(axes, ylabel=label)
    looks = {"wanted": (AMBER, (0, (4, 2))), "sent": (BLUE, "-"), "measured": (GREEN, (0, (1, 1))), "age": (BLUE, "-")}
    for name, values in lines.items():
        colour, dashes = looks[name]
        axes.plot(time, values, color=colour, linestyle=dashes, linewidth=1.3, label=name)
    if len(lines) > 1:
        axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, frameon=False, fontsize=SMALL, labelcolor=INK)


def _draw_states(axes: Axes, time: Float[np.ndarray, " n"], states: Sequence[str]) -> None:
    style_chart(axes, xlabel="seconds")
    starts = [0, *(index for index in range(1, len(states)) if states[index] != states[index - 1]), len(states) - 1]
    whole = time[-1] - time[0]
    for begin, end in pairwise(starts):
        axes.axvspan(time[begin], time[end], color=COLOURS[states[begin]], linewidth=0)
        width, middle = (time[end] - time[begin]) / whole, (time[begin] + time[end]) / 2
        if width > 0.02:  # a name needs its room
            turned = 0 if width > 0.07 else 90
            axes.text(
                middle, 0.5, states[begin], ha="center", va="center", rotation=turned, fontsize=SMALL - 1, color=PAPER
            )
    axes.set_yticks([])
    axes.grid(False)


def _first_of_each_fault(cycles: Sequence[Mapping]) -> list[str]:
    """The fault's name at the first period of every fault, empty at all others."""
    faults = [cycle.get("fault") or "" for cycle in cycles]
    return [fault if fault != before else "" for before, fault in zip(["", *faults], faults)]
