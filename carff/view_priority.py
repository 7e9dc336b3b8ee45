"""Which views the encoder practises on: those that it still gets wrong are drawn more often.

Evidence is unevenly spread: a truck fills half of one view and three pixels of another. Drawn evenly, views that were
learnt long ago take most of the time. (Schaul et al., Prioritized Experience Replay, 2016, without importance weights:
where one network must compromise between views, it leans towards the hard ones on purpose.)
"""

from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

MEMORY = 0.7  # of a view's remembered error at each new one: posterior samples make single errors noisy


class ViewPriority:
    """The running error of every view, and draws in proportion to it."""

    def __init__(self, views: int, hard_share: float, patience: int):
        """`hard_share` of the draws follow the errors, from the `patience`-th record on; the others are even."""
        self.hard_share, self.patience = hard_share, patience
        self.records = 0
        self.errors = torch.ones(views)

    def draw(self, count: int, generator: torch.Generator) -> Int[Tensor, " {count}"]:
        """Returns the rows of `count` views, drawn with replacement."""
        views = len(self.errors)
        total = self.errors.sum()
        share = self.hard_share if self.records >= self.patience and total > 0 else 0.0
        chance = (1 - share) / views + share * self.errors / total.clamp(min=1e-30)
        return torch.multinomial(chance, count, replacement=True, generator=generator)

    def record(self, rows: Int[Tensor, " n"], errors: Float[Tensor, " n"]) -> None:
        """Takes in the errors of views just encoded; what is not finite is left out."""
        self.records += 1
        good = errors.isfinite()
        if self.records < self.patience or not good.any():
            return
        if self.records == self.patience:
            self.errors.fill_(errors[good].mean())  # of views not met yet
        # a view may stand in a batch more than once: its errors are averaged
        total = torch.zeros_like(self.errors).index_add_(0, rows[good], errors[good])
        count = torch.zeros_like(self.errors).index_add_(0, rows[good], torch.ones_like(errors[good]))
        met = count > 0
        self.errors[met] = torch.lerp(total[met] / count[met], self.errors[met], MEMORY)

    def state_dict(self) -> dict[str, Any]:
        """What a resumed run needs to draw the same views."""
        return {"errors": self.errors, "records": self.records}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict`."""
        self.errors, self.records = state["errors"].clone(), state["records"]
