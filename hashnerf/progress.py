"""Progress of a loop on standard error: a bar with ETA on a terminal, else a plain ASCII line every few seconds."""

import math
import sys
import time

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

PLAIN_SECONDS = 5.0


class StepProgress:
    """Show how far a run of `total` steps has come, starting at `done`; it never raises when nobody can read it."""

    def __init__(self, title: str, done: int, total: int):
        self.title, self.first, self.total = title, done, total
        self.values = ""
        self._started = self._printed = time.monotonic()
        self._bar: Progress | None = None
        if sys.stderr.isatty():
            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeElapsedColumn(),
                TextColumn("ETA"),
                TimeRemainingColumn(),
                TextColumn("{task.fields[values]}"),
                console=Console(file=sys.stderr),
            )
            self._task = self._bar.add_task(title, total=total, completed=done, values="")
            self._bar.start()

    def show(self, done: int) -> None:
        """Report `done` finished steps."""
        if self._bar is not None:
            self._bar.update(self._task, completed=done, values=self.values)
        elif time.monotonic() - self._printed >= PLAIN_SECONDS or done == self.total:
            self._printed = time.monotonic()
            tail = f", {self.values}" if self.values else ""
            say(f"{self.title}: {done}/{self.total} steps, ETA {self._remaining(done)}{tail}")

    def close(self) -> None:
        """Leave the terminal as it was found."""
        if self._bar is not None:
            self._bar.stop()

    def _remaining(self, done: int) -> str:
        if done <= self.first:
            return "unknown"
        per_step = (time.monotonic() - self._started) / (done - self.first)
        seconds = math.ceil(per_step * (self.total - done))
        return f"{seconds // 3600}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"


def say(line: str) -> None:
    """Print one line to standard error; a closed terminal or a full disk behind it is no reason to stop."""
    try:
        print(line, file=sys.stderr, flush=True)
    except (OSError, ValueError):
        return
