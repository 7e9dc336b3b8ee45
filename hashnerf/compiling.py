"""Optional compilation: the same function, fused by `torch.compile` where a compiler works, plain where none does."""

import functools
import logging
from collections.abc import Callable

import torch

LOG = logging.getLogger(__name__)


@functools.cache
def _compiler_works() -> bool:
    """Compile a trivial function once; log one sentence if that fails."""
    try:
        torch.compile(lambda x: x + 1, dynamic=True)(torch.zeros(4))
    except Exception as error:  # whatever a broken tool chain raises, the plain functions still work
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        LOG.warning("torch.compile does not work here, running without it: %s", reason)
        return False
    return True


@functools.cache
def _compiled(function: Callable) -> Callable:
    return torch.compile(function, dynamic=True)


def compiled_or_eager(function: Callable, eager: Callable, compile: bool) -> Callable:
    """Return `function` compiled (once per process) if asked and possible, else `eager`."""
    return _compiled(function) if compile and _compiler_works() else eager
