"""Where the time of a training goes: parts of a step, and kernels.

The parts are labelled where they run (`hashnerf.fit`, `hashnerf.render`), the kernels are the library's own and the
autograd functions of the hash grid and the networks. A profile costs time itself: shares count, not milliseconds.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from torch.profiler import ProfilerActivity, profile

from hashnerf.fit import BACKWARD, DRAW, OCCUPANCY, STEP, UPDATE
from hashnerf.render import FIELD, MARCH
from hashnerf.report_tables import Table

PARTS = {DRAW: "", OCCUPANCY: "", STEP: "", MARCH: "· ", FIELD: "· ", BACKWARD: "· ", UPDATE: "· "}
"""Parts of a training, those of a step with a mark before them."""
KERNELS = 14
"""Kernels that are listed, the dearest first."""


@dataclass(frozen=True)
class TrainingProfile:
    """Milliseconds over a whole training."""

    steps: int
    parts_ms: Mapping[str, float]
    kernels_ms: Mapping[str, tuple[float, int]]
    """Time in a kernel itself and how often it was called, the dearest first."""

    @property
    def total_ms(self) -> float:
        """All that belongs to the steps; start and saving do not."""
        return sum(ms for name, ms in self.parts_ms.items() if not PARTS[name])


def profile_training(train: Callable[[], None]) -> TrainingProfile:
    """Runs a training under the profiler."""
    with profile(activities=[ProfilerActivity.CPU]) as profiler:
        train()
    events = {event.key: event for event in profiler.key_averages()}
    steps = events[STEP].count if STEP in events else 0
    parts = {name: events[name].cpu_time_total / 1000 for name in PARTS if name in events}
    own = sorted(events.values(), key=lambda event: -event.self_cpu_time_total)
    kernels = {e.key: (e.self_cpu_time_total / 1000, e.count) for e in own if e.key not in PARTS}
    return TrainingProfile(steps, parts, kernels)


def parts_table(found: TrainingProfile) -> Table:
    """Returns milliseconds a step and shares of every part."""
    rows = tuple(
        (f"{PARTS[name]}{name}", f"{ms / found.steps:.2f} ms", f"{100 * ms / found.total_ms:.1f} %")
        for name, ms in found.parts_ms.items()
    )
    return Table(("part", "a step", "share"), rows)


def kernels_table(found: TrainingProfile) -> Table:
    """Returns the dearest kernels: time in the kernel itself."""
    dearest = list(found.kernels_ms.items())[:KERNELS]
    rows = tuple(
        (f"`{name}`", f"{ms / found.steps:.2f} ms", f"{100 * ms / found.total_ms:.1f} %", f"{count / found.steps:.1f}")
        for name, (ms, count) in dearest
    )
    return Table(("kernel", "a step, itself", "share", "calls a step"), rows)
