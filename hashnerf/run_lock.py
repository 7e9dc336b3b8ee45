"""A lock on a run folder, so that two processes never write one run.

The kernel holds the lock (flock), so it vanishes with its process, kill -9 included; the file's text (process id and
host) is for people, and for another machine on a shared file system, whose kernel may not see the lock.
"""

import fcntl
import json
import os
import socket
from pathlib import Path

from hashnerf.errors import UserError


class RunLock:
    """Hold `folder/.lock` from `acquire` to `release`, or for a block; UserError names the process that has it."""

    def __init__(self, folder: Path):
        self.path = folder / ".lock"
        self._descriptor: int | None = None

    def __enter__(self) -> "RunLock":
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.acquire()
        return self

    def __exit__(self, *exception: object) -> None:
        self.release()

    def acquire(self) -> None:
        """Take the lock at once or raise UserError saying who has it."""
        descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(descriptor)
            raise UserError(
                f"{self.path.parent}: in use by {self._holder()}; wait for it or choose another run."
            ) from error
        host = self._owner().get("host", socket.gethostname())
        if host != socket.gethostname():
            os.close(descriptor)
            raise UserError(
                f"{self.path.parent}: last used by {self._holder()}, which did not end cleanly; "
                f"if it runs no more, delete {self.path} and start again."
            )
        os.ftruncate(descriptor, 0)
        os.write(descriptor, json.dumps({"pid": os.getpid(), "host": socket.gethostname()}).encode())
        self._descriptor = descriptor

    def release(self) -> None:
        """Give the lock back; the empty file stays, because deleting it could let two others lock two files."""
        if self._descriptor is not None:
            os.ftruncate(self._descriptor, 0)
            os.close(self._descriptor)
            self._descriptor = None

    def _owner(self) -> dict:
        try:
            owner = json.loads(self.path.read_text())
        except (OSError, ValueError):
            return {}
        return owner if isinstance(owner, dict) else {}

    def _holder(self) -> str:
        owner = self._owner()
        return f"process {owner.get('pid', 'unknown')} on {owner.get('host', 'an unknown host')}"
