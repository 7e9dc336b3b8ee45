"""The same work on many items in several processes, each with one thread and what it needs made once."""

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, TypeVar

import torch

Item = TypeVar("Item")
Result = TypeVar("Result")


def map_in_processes(
    make: Callable[[], Callable[[Item], Result]], items: Sequence[Item], workers: int, chunk: int = 1
) -> Iterator[Result]:
    """Yields the results of all items in order; `make` gives each process its function, and must be picklable.

    With one worker everything runs here, with the threads that this process has.
    """
    if workers <= 1 or len(items) <= chunk:
        yield from map(make(), items) if items else ()
        return
    # spawned, not forked: a fork while OpenMP threads run can hang
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(workers, len(items)), context, _start, (make,))
    try:
        yield from pool.map(_work, items, chunksize=chunk)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


_make: Callable[[], Callable[[Any], Any]] | None = None
_function: Callable[[Any], Any] | None = None


def _start(make: Callable[[], Callable[[Any], Any]]) -> None:
    global _make
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    _make = make


def _work(item: Any) -> Any:
    # made with the first item, not in the initializer: an error there would break the pool without a word
    global _function
    if _function is None:
        assert _make is not None
        _function = _make()
        torch.set_num_threads(1)  # last: loading a config may have asked for more
    return _function(item)
