"""The guard before other processes, in memory for good, and gone when nobody minds it any more (Linux)."""

import contextlib
import ctypes
import gc
import os
import signal
import time

_PR_SET_PDEATHSIG = 1
_CURRENT = 1
"""Not what comes later: under a small limit that would make later allocations fail."""


def prefer() -> bool:
    """Runs before ordinary processes and keeps its memory, as far as the system allows; returns whether it runs first.

    Both are only precautions.
    """
    hurried = True
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, -15)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except OSError:
        hurried = False
    ctypes.CDLL(None).mlockall(_CURRENT)
    gc.freeze()  # what is loaded by now is not looked through again
    return hurried


def die_with_parent(number: signal.Signals) -> None:
    """Has the system send a signal when the process that started us ends."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(number))


def end_child(process: int, seconds: float) -> int:
    """Waits for a child to end, at most so many seconds, then kills it; returns its exit code, 0 for no child."""
    if process < 0:
        return 0
    ends = time.monotonic() + seconds
    killed = False
    while True:
        try:
            done, status = os.waitpid(process, os.WNOHANG)
        except ChildProcessError:  # whoever started us has the system forget children
            return 0
        if done:
            return os.waitstatus_to_exitcode(status)
        if not killed and time.monotonic() >= ends:
            os.kill(process, signal.SIGKILL)
            killed = True
        time.sleep(0.005)
