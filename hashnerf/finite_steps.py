"""Skips optimiser steps whose loss or gradient is not finite: one NaN gradient poisons Adam's moments for good."""

from torch import Tensor

from hashnerf.errors import UserError

MOST_IN_A_ROW = 10


class FiniteSteps:
    """Counts skipped steps and gives up after more than ten in a row."""

    def __init__(self) -> None:
        self.skipped = 0
        self.in_a_row = 0

    def accepts(self, step: int, terms: dict[str, Tensor | float]) -> bool:
        """Returns whether every term is finite; raises UserError names the bad ones at the eleventh failure running."""
        bad = [name for name, value in terms.items() if not abs(float(value)) < float("inf")]
        if not bad:
            self.in_a_row = 0
            return True
        self.skipped += 1
        self.in_a_row += 1
        if self.in_a_row > MOST_IN_A_ROW:
            raise UserError(
                f"training broke down at step {step}: {', '.join(bad)} not finite {self.in_a_row} times in a row; "
                "lower the learning rate"
            )
        return False
