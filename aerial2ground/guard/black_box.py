"""The black box: one line of JSON a cycle, written by a thread so that no disk can hold up the loop.

`log.jsonl` grows to 100 MB at most. `last_minute.jsonl` is a ring of 3000 lines of a fixed length whose place on the
disk is taken before the drive, so that the last minute is there even when the disk is full.
"""

import json
import os
import threading
from collections import deque
from pathlib import Path

from hashnerf.errors import UserError

CAP = 100_000_000
SLOTS, SLOT = 3000, 1024
"""Lines of the ring, and bytes of each: a minute at 50 a second."""
QUEUE = 3000
CUT = b'{"in":"cut"}\n'


class BlackBox:
    """A log in a folder; `lost` counts the lines that could not be written."""

    def __init__(self, folder: Path, cap: int = CAP):
        """Makes the folder and takes the ring's place; raises UserError where there is no room for it."""
        self.lost = 0
        self._cap, self._written, self._slot = cap, 0, 0
        self._lines: deque[tuple[bytes, bytes]] = deque(maxlen=QUEUE)
        self._there = threading.Event()
        self._ends = False
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._ring = _ring(folder / "last_minute.jsonl")
        except OSError as error:
            raise UserError(f"{folder}: the log has no place there ({error.strerror}); give another --log") from error
        self._log: int | None = None
        self._path = folder / "log.jsonl"
        self._thread = threading.Thread(target=self._write_all, daemon=True)
        self._thread.start()

    def add(self, record: dict) -> None:
        """Queues a record; never waits."""
        if len(self._lines) == QUEUE:
            self.lost += 1
        line = _line(record)
        # of a period that is flooded the ring keeps what went out, not what came in
        fitting = (one for one in (line, _line(record | {"in": "cut"}), CUT) if len(one) <= SLOT)
        self._lines.append((line, next(fitting)))
        self._there.set()

    def close(self, seconds: float = 1.0) -> None:
        """Writes what is queued, for at most so many seconds; a disk that hangs is left behind."""
        self._ends = True
        self._there.set()
        self._thread.join(seconds)

    def _write_all(self) -> None:
        while not self._ends or self._lines:
            self._there.wait()
            self._there.clear()
            while self._lines:
                self._write(*self._lines.popleft())
        os.close(self._ring)
        if self._log is not None:
            os.close(self._log)

    def _write(self, line: bytes, short: bytes) -> None:
        try:
            os.pwrite(self._ring, short[:-1].ljust(SLOT - 1) + b"\n", self._slot * SLOT)
            self._slot = (self._slot + 1) % SLOTS
            if self._written + len(line) > self._cap:
                raise OSError("over the cap")
            if self._log is None:  # opened here: a disk may let us wait for this, too
                flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NONBLOCK
                self._log = os.open(self._path, flags, 0o644)
            self._written += os.write(self._log, line)
        except OSError:
            self.lost += 1


def _ring(path: Path) -> int:
    """Opens the ring and takes its place on the disk."""
    ring = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o644)
    try:
        os.posix_fallocate(ring, 0, SLOTS * SLOT)
    except OSError:
        os.close(ring)
        raise
    return ring


def _line(record: dict) -> bytes:
    return json.dumps(record, separators=(",", ":")).encode() + b"\n"
