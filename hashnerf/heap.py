"""Keeping freed memory in the process: a training step asks for the same large tensors as the one before.

The allocator of the GNU C library hands large blocks back to the system as soon as they are free and asks for them
again a moment later; each time the system clears every page. That costs a training step on a processor 3 to 12 %
(docs/results/core_notes.md).
"""

import ctypes

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # malloc.h of the GNU C library
KEPT = 1 << 29  # bytes: more than the temporary tensors of a step of any preset


def keep_freed_memory() -> bool:
    """Lets this process keep up to 512 MiB that it has freed; returns False where the C library has no such setting."""
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library, or another system
        return False
    # both: the first one alone stops the library from adapting the second
    return bool(mallopt(M_TRIM_THRESHOLD, KEPT)) and bool(mallopt(M_MMAP_THRESHOLD, KEPT))
