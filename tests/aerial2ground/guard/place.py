"""What the guard's process is given in a test: standard input, the policy's socket, a port."""

import contextlib
import json
import os
import select
import socket
import sys
import threading
import time
import tty
from types import SimpleNamespace

from aerial2ground.guard import guard_process
from tests.aerial2ground.guard.bench import answer, crc16

PATIENCE = 30.0


class Place:
    """What the guard's process is given: standard input, the policy's socket, a port; `plan` acts from a thread."""

    def __init__(self, folder, monkeypatch):
        self.folder, self.prepared, self.heard = folder, [], b""
        self.reader, self.keys = os.pipe()
        self.policy, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.policy_socket = theirs.detach()  # the guard closes it
        self.master, self._slave = os.openpty()
        tty.setraw(self.master)
        self.port = os.ttyname(self._slave)
        self._ends, self._threads = threading.Event(), []
        monkeypatch.setattr(sys, "stdin", SimpleNamespace(fileno=lambda: self.reader))
        monkeypatch.setattr(guard_process, "prefer", lambda: self.prepared.append("prefer") is None)
        monkeypatch.setattr(guard_process, "die_with_parent", self.prepared.append)

    def settings(self, **changed) -> dict:
        """Of the process, without a port."""
        return {"actuation": {}, "guard": {}, "policy_socket": self.policy_socket, "log": str(self.folder)} | changed

    def start(self, act, *arguments) -> None:
        """Runs something beside the guard."""
        thread = threading.Thread(target=act, args=arguments)
        self._threads.append(thread)
        thread.start()

    def controller(self) -> None:
        """Answers as a motor controller does, and keeps what it heard."""
        while True:
            if not select.select([self.master], [], [], 0.02)[0]:
                if self._ends.is_set():
                    return
                continue
            try:
                data = os.read(self.master, 4096)
            except OSError:
                continue
            self.heard += data
            for question, payload in ((b"\x02\x01\x00", b"\x00\x06\x02bench\x00"), (b"\x02\x01\x04", answer())):
                for _ in range(data.count(question)):
                    framed = bytes([2, len(payload)]) + payload + crc16(payload).to_bytes(2, "big") + b"\x03"
                    os.write(self.master, framed)

    def wait_for(self, what) -> None:
        """Waits until something is true."""
        ends = time.monotonic() + PATIENCE
        while not what() and time.monotonic() < ends:
            time.sleep(0.005)

    def first_line(self) -> dict:
        """Of the black box."""
        return json.loads((self.folder / "log.jsonl").read_text().splitlines()[0])

    def lines(self) -> list[dict]:
        """All others."""
        return [json.loads(line) for line in (self.folder / "log.jsonl").read_text().splitlines()[1:]]

    def end_threads(self) -> None:
        """Ends what runs beside the guard."""
        self._ends.set()
        for thread in self._threads:
            thread.join(PATIENCE)
            assert not thread.is_alive()

    def close(self) -> None:
        """Ends the threads and closes everything."""
        self.end_threads()
        self.policy.close()
        for descriptor in (self.reader, self.keys, self.master, self._slave, self.policy_socket):
            with contextlib.suppress(OSError):  # the guard or the test has closed it
                os.close(descriptor)


def closed(descriptor: int) -> bool:
    try:
        os.fstat(descriptor)
    except OSError:
        return True
    return False
