"""Which pictures have one right decision, and which one: the ground truth of open-loop planning.

A *hidden* hazard: the picture comes from a hazardous state and fits a state without hazard as well. A *shown* one fits
hazardous states alone. A *clear* picture fits no state that is or turns hazardous. The flag speaks of the present
state, a forecast of the next one: views of states whose flag changes with the next step are of no kind.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Int
from torch import Tensor


@dataclass(frozen=True)
class PictureKinds:
    """One row a view."""

    hidden: Bool[Tensor, " n"]
    shown: Bool[Tensor, " n"]
    clear: Bool[Tensor, " n"]

    def name(self, row: int) -> str:
        """Returns `hidden`, `shown`, `clear`, or `other` where no decision is the only right one."""
        return next((name for name in ("hidden", "shown", "clear") if getattr(self, name)[row]), "other")


def picture_kinds(
    state: Int[Tensor, " n"],
    picture: Int[Tensor, " n"],
    hazard: Bool[Tensor, " states"],
    successor: Int[Tensor, " states"],
) -> PictureKinds:
    """Returns the kind of each view, given its state and its picture (equal numbers: equal pictures).

    `hazard` and `successor` (-1: none) are those of the states.
    """
    goes_on = successor >= 0
    steady = (goes_on & (hazard == hazard[successor]))[state]
    unsafe = hazard | (goes_on & hazard[successor])

    def occurs(states: Bool[Tensor, " states"]) -> Bool[Tensor, " n"]:
        seen = torch.zeros(int(picture.max()) + 1, dtype=torch.bool)
        seen[picture[states[state]]] = True
        return seen[picture]

    danger = steady & hazard[state]
    return PictureKinds(danger & occurs(~hazard & goes_on), danger & ~occurs(~hazard), steady & ~occurs(unsafe))
