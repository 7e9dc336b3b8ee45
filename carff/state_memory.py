"""What earlier pictures rule out: a belief over the present state, carried from picture to picture.

A network that reads single pictures can misread one, most easily between two steps of the data, where nothing looks
like a known state. What it read before, moved on by the learned forecast, tells which readings are possible now. The
futures of a reading that was ruled out count as *unknown*, so memory only ever adds caution: no hazard is taken away.

    b <- (1 - a) b + a b T                    a = seconds passed / seconds per step, at most 1/2
    ruled out: readings whose share of b, pooled over the states with the same boxes, is below RULED_OUT
    b <- (b (q + DOUBT) / sum + q) / 2        or (1 - w) b + w q where most readings were ruled out

q is the mean posterior of a picture's sampled readings (b of the first picture), T the probability of each state's
successors, w = TRUST_IN_CONTRADICTION. Half of the new belief is Bayes' rule: two clear pictures settle it. Half is the
picture alone: successive pictures err alike, and a view that leaves two states open must leave them open however often
it is seen. About three contradicting pictures are needed until the memory gives way.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from carff.model import CarffModel
from hashnerf.low_precision import without_autocast

RULED_OUT = 0.1
DOUBT = 0.05
TRUST_IN_CONTRADICTION = 0.05
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
        self, transitions: Float[Tensor, "states states"], same: Bool[Tensor, "states states"], step_seconds: float
    ):
        """`same` tells which states have the same boxes: they are one reading."""
        self.transitions, self.same, self.step_seconds = transitions, same.float(), step_seconds
        self.least = min(RULED_OUT, 0.5 / len(same.unique(dim=0)))
        self.belief = torch.full((len(transitions),), 1 / len(transitions))
        self.time: float | None = None

    @without_autocast
    def rule_out(self, time: float, posterior: Float[Tensor, "n states"]) -> Bool[Tensor, " n"]:
        """Takes in the sampled readings of the picture at `time` (seconds); returns which of them cannot be."""
        reading = posterior.mean(dim=0)
        if self.time is None:
            self.belief, self.time = reading, time
            return torch.zeros(len(posterior), dtype=torch.bool)
        # half of a state stays whatever the time: an ego that waits must not forget what it goes on seeing
        share = min(max(time - self.time, 0.0) / self.step_seconds, 0.5)
        moved = (1 - share) * self.belief + share * self.belief @ self.transitions
        impossible = posterior @ (self.same @ moved) < self.least
        self.time = time
        if impossible.float().mean() > 0.5:
            self.belief = (1 - TRUST_IN_CONTRADICTION) * moved + TRUST_IN_CONTRADICTION * reading
        else:
            product = moved * (reading + DOUBT)
            self.belief = (product / product.sum() + reading) / 2
        return impossible
