"""What earlier pictures rule out: a belief over the states one step ahead, carried from picture to picture.

A network that reads single pictures can misread one, most easily between two steps of the data, where nothing looks
like a known state. What it read before, moved on by the learned forecast, tells which readings are possible now. A
reading that was ruled out counts as *unknown*, so memory only ever adds caution: no hazard is taken away.

    b <- (1 - a) b + a b T                      a = seconds passed / seconds per step, at most 1/2
    ruled out: readings whose share of b, pooled over the states with the same boxes, is below RULED_OUT
    b <- b (q + DOUBT) / sum, then LEAK of it spread evenly

q is the mean posterior of the sampled readings, T the probability of each state's successors. DOUBT is large because
successive pictures err alike: after two or three contradicting pictures the memory gives way.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from carff.model import CarffModel

RULED_OUT = 0.02
DOUBT = 0.5
LEAK = 0.005
DRAWS = 64


@torch.no_grad()
def state_transitions(model: CarffModel, generator: torch.Generator) -> Float[Tensor, "states states"]:
    """Returns the probability of every state (columns) one step after every other (rows); a last state stays."""
    beliefs = model.state_beliefs
    latents = model.mdn(beliefs.mean, beliefs.logvar).sample(DRAWS, generator)
    posterior = model.probe.state_posterior(model.probe_scores(latents.flatten(0, 1)))
    ahead = posterior.reshape(len(beliefs), DRAWS, -1).mean(dim=1)
    last = (model.scene.successor < 0)[:, None]
    return torch.where(last, torch.eye(len(beliefs)), ahead)


class StateMemory:
    """The belief of one drive; nothing is known before the first picture."""

    def __init__(
        self, transitions: Float[Tensor, "states states"], occupied: Bool[Tensor, "states boxes"], step_seconds: float
    ):
        self.transitions, self.step_seconds = transitions, step_seconds
        # states with the same boxes are one reading
        self.same = (occupied[:, None] == occupied[None]).all(dim=-1).float()
        readings = len(occupied.unique(dim=0))
        self.least = min(RULED_OUT, 0.1 / readings)
        self.belief = torch.full((len(transitions),), 1 / len(transitions))
        self.time: float | None = None

    def rule_out(self, time: float, posterior: Float[Tensor, "n states"]) -> Bool[Tensor, " n"]:
        """Takes in the sampled readings of the picture at `time` (seconds); returns which of them cannot be."""
        impossible = torch.zeros(len(posterior), dtype=torch.bool)
        if self.time is not None:
            # half of a state stays whatever the time: an ego that waits must not forget what it goes on seeing
            share = min(max(time - self.time, 0.0) / self.step_seconds, 0.5)
            self.belief = (1 - share) * self.belief + share * self.belief @ self.transitions
            impossible = posterior @ (self.same @ self.belief) < self.least
        self.time = time
        belief = self.belief * (posterior.mean(dim=0) + DOUBT)
        self.belief = (1 - LEAK) * belief / belief.sum() + LEAK / len(belief)
        return impossible
