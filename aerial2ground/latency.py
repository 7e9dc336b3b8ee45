"""How long one picture takes to be answered, on one thread: what a car's computer does between two frames."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import UInt8

from hashnerf.errors import UserError


@dataclass(frozen=True)
class Latency:
    """Milliseconds for one picture."""

    median: float
    """Half of the pictures take longer."""
    p99: float
    """One of a hundred takes longer."""


def latency_ms(
    answer: Callable[[UInt8[np.ndarray, "h w c"]], object],
    picture: UInt8[np.ndarray, "h w c"],
    frames: int = 500,
    warm_up: int = 50,
    clock: Callable[[], float] = time.perf_counter,
) -> Latency:
    """Times `answer(picture)` once a frame after `warm_up` calls that do not count; `clock` gives seconds.

    torch works on one thread meanwhile; its number of threads is restored. Raises UserError for no frames.
    """
    if frames < 1 or warm_up < 0:
        raise UserError(f"frames = {frames} and warm_up = {warm_up} measure nothing; give at least 1 and 0")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        for _ in range(warm_up):
            answer(picture)
        seconds = np.empty(frames)
        for frame in range(frames):
            start = clock()
            answer(picture)
            seconds[frame] = clock() - start
    finally:
        torch.set_num_threads(threads)
    median, p99 = np.percentile(1000 * seconds, [50, 99])
    return Latency(float(median), float(p99))
