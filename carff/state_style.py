"""Colours that mean the same thing in every figure of a CARFF report.

A *state* has one colour in all figures: its hue says the branch, its darkness the step (light = early). Data with a
single branch uses one sequential scale over the steps instead.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex, to_rgb

from hashnerf.figure_style import AMBER, BLUE, GREEN, PURPLE, SKY, VERMILION

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


def _shade(colour: str, depth: float) -> str:
    """The hue mixed with white for depth 0 and with black for depth 1."""
    rgb = np.array(to_rgb(colour))
    mixed = rgb + (1 - rgb) * (0.5 - depth) if depth < 0.5 else rgb * (1 - 0.75 * (depth - 0.5))
    return to_hex(mixed)
