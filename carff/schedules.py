"""Weights and rates as pure functions of the epoch or step: a resumed run takes the path of an uninterrupted one."""

import math

from hashnerf.errors import UserError


def delayed_linear(
    epoch: float | int, start_value: float, end_value: float, start_epoch: float | int, end_epoch: float | int
) -> float:
    """Returns `start_value`, from `start_epoch` a line to `end_value`, kept from `end_epoch` on.  # CARFF Table 4

    Equal epochs make a step: `end_value` from that epoch on. Raises UserError if the ramp ends before it starts or a
    value is not finite.
    """
    if not all(map(math.isfinite, (epoch, start_value, end_value, start_epoch, end_epoch))):
        raise UserError(f"schedule at epoch {epoch}: every epoch and weight must be a finite number")
    if end_epoch < start_epoch:
        raise UserError(f"schedule ends at epoch {end_epoch}, before it starts at {start_epoch}; exchange the two")
    if epoch >= end_epoch:
        return end_value
    if epoch <= start_epoch:
        return start_value
    return start_value + (end_value - start_value) * (epoch - start_epoch) / (end_epoch - start_epoch)


def cosine_rate(step: int, steps: int, initial: float, final: float, warm_up: int = 0) -> float:
    """Returns a rate that falls from `initial` at step 0 to `final` at `steps` along half a cosine, and stays there.

    The first `warm_up` steps rise to it in equal parts.
    """
    if steps < 1:
        raise UserError(f"a schedule over {steps} steps is empty; give at least 1")
    progress = min(max(step / steps, 0.0), 1.0)
    rate = final + 0.5 * (initial - final) * (1 + math.cos(math.pi * progress))
    return rate * min(1.0, (step + 1) / warm_up) if warm_up else rate
