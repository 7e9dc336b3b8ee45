"""Exponential moving average of weights, in float32, debiased: a true average from the first step."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn

from hashnerf.errors import UserError


class WeightAverage:
    """Remembers averaged parameters of a module; buffers are not averaged (the radiance field has none that learn)."""

    def __init__(self, module: nn.Module, decay: float):
        if not 0 <= decay < 1:
            raise UserError(f"the decay of the weight average is {decay}: use 0 or more and less than 1")
        self.decay = decay
        self.updates = 0
        self.names = [name for name, _ in module.named_parameters()]
        self.parameters = [parameter for _, parameter in module.named_parameters()]
        # half-precision averages stall: the step (1 - decay) * difference rounds to nothing
        self.averages = [parameter.detach().float().clone() for parameter in self.parameters]

    @torch.no_grad()
    def update(self) -> None:
        """Take in the present weights."""
        self.updates += 1
        # running form of sum(d^k w)/sum(d^k): the first update copies the weights, later ones approach 1 - decay
        share = (1 - self.decay) / (1 - self.decay**self.updates)
        weights = [parameter.detach().float() for parameter in self.parameters]
        torch._foreach_lerp_(self.averages, weights, share)

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Let the module hold the averaged weights inside a `with` block."""
        if not self.updates:
            yield
            return
        present = [parameter.detach().clone() for parameter in self.parameters]
        self._assign(self.averages)
        try:
            yield
        finally:
            self._assign(present)

    @torch.no_grad()
    def _assign(self, values: list[Tensor]) -> None:
        for parameter, value in zip(self.parameters, values):
            parameter.copy_(value)

    def state_dict(self) -> dict:
        """The averages by parameter name, and how many weights they hold."""
        return {"updates": self.updates, "averages": dict(zip(self.names, self.averages))}

    def load_state_dict(self, state: dict) -> None:
        """Continue from a saved state of the same module."""
        self.updates = state["updates"]
        for name, average in zip(self.names, self.averages):
            average.copy_(state["averages"][name])
