"""Comparing how long functions take on a machine that others use, too.

The functions run in turns, so that a busy while slows all of them; medians over the turns leave it out.
"""

from collections.abc import Callable, Mapping
from statistics import median
from time import perf_counter

import torch


def seconds_in_turns(functions: Mapping[str, Callable[[], object]], turns: int) -> dict[str, float]:
    """Returns the median wall-clock seconds of every function over `turns` turns, after one that warms up.

    Raises ValueError for less than one turn.
    """
    if turns < 1:
        raise ValueError(f"{turns} turns: use at least 1")
    taken: dict[str, list[float]] = {name: [] for name in functions}
    for turn in range(turns + 1):
        for name, function in functions.items():
            start = perf_counter()
            function()
            if torch.cuda.is_available():
                torch.cuda.synchronize()  # a call only queues the work
            seconds = perf_counter() - start
            if turn:
                taken[name].append(seconds)
    return {name: median(values) for name, values in taken.items()}
