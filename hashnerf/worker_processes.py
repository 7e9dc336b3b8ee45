"""The same work on many items in several processes, each with one thread and what it needs made once."""

import functools
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any, TypeVar

import torch

from hashnerf.errors import UserError
from hashnerf.heap import keep_freed_memory

Item = TypeVar("Item")
Result = TypeVar("Result")
Mapped = Callable[[Sequence[Item]], Iterator[Result]]


@contextmanager
def worker_processes(
    make: Callable[[], Callable[[Item], Result]], workers: int, chunk: int = 1
) -> Iterator[Mapped[Item, Result]]:
    """Gives a map over sequences that may be used again and again; its results come in order.

    `make` gives each process its function, and must be picklable. With one worker everything runs here, with the
    threads that this process has. Processes start with the first items, and end with the block.
    """
    if workers <= 1:
        made = functools.cache(make)
        yield lambda items: map(made(), items) if items else iter(())
        return
    # spawned, not forked: a fork while OpenMP threads run can hang
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _start, (make,))

    def there(items: Sequence[Item]) -> Iterator[Result]:
        with _deaths_told(), _interrupts_held():
            return _in_order(pool.map(_work, items, chunksize=chunk))

    try:
        yield there
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def map_in_processes(
    make: Callable[[], Callable[[Item], Result]], items: Sequence[Item], workers: int, chunk: int = 1
) -> Iterator[Result]:
    """Yields the results of all items in order, as `worker_processes` gives them; few items are worked on here."""
    workers = 1 if len(items) <= chunk else min(workers, len(items))
    with worker_processes(make, workers, chunk) as mapped:
        yield from mapped(items)


def _in_order(results: Iterator[Result]) -> Iterator[Result]:
    with _deaths_told():
        yield from results


@contextmanager
def _deaths_told() -> Iterator[None]:
    """A process that the system kills, mostly for its memory, is told in a sentence."""
    try:
        yield
    except BrokenProcessPool as error:
        raise UserError(
            "a worker process was killed: give fewer workers if memory is short, and start again"
        ) from error


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Processes started in the block are deaf to Ctrl-C from their first instruction; ours comes after the block."""
    resource_tracker.ensure_running()  # its own start would end the hold
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_make: Callable[[], Callable[[Any], Any]] | None = None
_function: Callable[[Any], Any] | None = None


def _start(make: Callable[[], Callable[[Any], Any]]) -> None:
    global _make
    # Ctrl-C is the parent's to handle; held until here, then let go for what this process may start itself
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    keep_freed_memory()
    _make = make


def _leave_with_parent() -> None:
    """A parent that is killed cannot end its processes: they would wait for work for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _work(item: Any) -> Any:
    # made with the first item, not in the initializer: an error there would break the pool without a word
    global _function
    if _function is None:
        assert _make is not None
        _function = _make()
        torch.set_num_threads(1)  # last: loading a config may have asked for more
    return _function(item)
