"""The guard's loop in virtual time: its waiting is replaced by a world in which policy, operator and car act in turn.

Sockets and pipes are real, so that what the loop reads and writes is real, too; only time is not.
"""

import heapq
import itertools
import json
import os
import select
import socket
from types import SimpleNamespace

from aerial2ground.guard import loop as loop_module
from aerial2ground.guard.black_box import BlackBox
from aerial2ground.guard.guard import Guard
from aerial2ground.guard.loop import Loop
from aerial2ground.guard.operator_input import Keyboard
from aerial2ground.guard.serial_link import SerialLink
from aerial2ground.guard.states import State
from hashnerf.errors import UserError
from tests.aerial2ground.guard.bench import CAR, DEFAULTS, CarModel, command, crc16, sent, taken_apart

START = 1000.0


class Link(SerialLink):
    """A port to the world's car; `fails` is what the next calls raise."""

    def __init__(self, world: "World"):
        self.world, self.fails, self.dropped, self.closed = world, {}, 0, False
        self.ours, self.theirs = socket.socketpair()

    def fileno(self) -> int:
        """For select."""
        return self.ours.fileno()

    def _fail(self, name: str) -> None:
        if name in self.fails:
            raise self.fails[name]

    def read(self) -> bytes:
        """What the car has sent."""
        self._fail("read")
        return self.ours.recv(4096)

    def write(self, data: bytes) -> None:
        """To the car."""
        self._fail("write")
        self.world.written(self, data)

    def drop_waiting(self) -> None:
        """Counted."""
        self.dropped += 1
        self._fail("drop")

    def close(self) -> None:
        """Closes both ends."""
        self.closed = True
        self.ours.close()
        self.theirs.close()


class World:
    """A loop and everything around it; `at` plans what happens when."""

    def __init__(self, folder, monkeypatch, port="port", **changed):
        self.now, self.car, self.said = START, CarModel(), []
        self.wire = []
        """(time, state, frames) of everything that was written."""
        self.links, self.attempts, self.no_port = [], [], False
        self.policy_lives, self.hand, self.steering, self.speed = True, False, 0.0, 0.0
        self.listens, self.heard = True, []
        self._plan, self._order, self._number = [], itertools.count(), 0
        self.ours, self.policy = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.signals, self.kill = socket.socketpair()
        for one in (self.ours, self.policy, self.signals):
            one.setblocking(False)
        reader, self._keys = os.pipe()
        self._open_pipes = {reader, self._keys}
        self.black_box = BlackBox(folder / "log")
        self.log = folder / "log" / "log.jsonl"
        monkeypatch.setattr(loop_module, "SerialLink", self._open)
        monkeypatch.setattr(loop_module, "select", SimpleNamespace(select=self._select))
        self._keyboard = Keyboard(reader, True)
        parts = {"inputs": [self._keyboard], "polled": [], "say": self.said.append, "clock": lambda: self.now}
        parts |= changed
        self.guard = Guard(CAR, DEFAULTS)
        self.loop = Loop(self.guard, port, self.ours, signals=self.signals, black_box=self.black_box, **parts)
        self.at(0.0, lambda: self.policy.send(b"ready"))
        self.at(0.007, self._period)

    def at(self, seconds: float, action) -> None:
        """Plans an action, or words of the operator, so many seconds after the start."""
        act = action if callable(action) else lambda: self.type(action)
        heapq.heappush(self._plan, (START + seconds, next(self._order), act))

    def type(self, words: str) -> None:
        """The operator types."""
        os.write(self._keys, words.encode())

    def close_keys(self) -> None:
        """Standard input ends."""
        self._open_pipes.remove(self._keys)
        os.close(self._keys)

    def send(self, **changed) -> None:
        """The policy sends a command on a new picture."""
        self._number += 1
        speed = self.speed if self.guard.state is State.ARMED else 0.0
        numbers = {"number": self._number, "picture": self._number, "taken": self.now - 0.03, "sent": self.now}
        self.policy.send(command(**numbers | {"steering": self.steering, "speed": speed} | changed))

    def _period(self) -> None:
        """What policy and hand do 50 times a second."""
        if self.policy_lives:
            self.send()
            if self.listens:
                self.listen()
        if self.hand:
            self.type("g")
        self.at(self.now - START + 0.02, self._period)

    def _select(self, readers, _, __, seconds):
        ends = self.now + seconds
        while True:
            readable = select.select(readers, [], [], 0)[0]
            planned = self._plan[0][0] if self._plan else ends + 1
            if readable or (self.now >= ends and planned > ends):
                return readable, [], []
            if planned <= ends:
                self.now = max(self.now, planned)
                heapq.heappop(self._plan)[2]()
            else:
                self.now = ends

    def _open(self, port: str) -> Link:
        self.attempts.append(self.now - START)
        if self.no_port:
            raise UserError(f"{port}: there is no such port")
        self.links.append(Link(self))
        return self.links[-1]

    def written(self, link: Link, data: bytes) -> None:
        """The loop has written to the car, which answers after 2 ms."""
        frames = taken_apart(data)
        self.wire.append((self.now - START, self.guard.state, frames))
        self.car.obey(frames, self.now)
        says, self.car.says = self.car.says, []
        for payload in says:
            whole = bytes([2, len(payload)]) + payload + crc16(payload).to_bytes(2, "big") + b"\x03"
            self.at(self.now - START + 0.002, lambda whole=whole: self.answer(link, whole))

    def answer(self, link: Link, data: bytes) -> None:
        """The car sends bytes."""
        if not link.closed:
            link.theirs.send(data)

    def arms(self, speed: float = 1.0) -> "World":
        """Plans what it takes to drive from second 5 on; returns itself."""
        for seconds, words in ((1.0, "check\n"), (2.5, "yes\n"), (3.7, "arm\n")):
            self.at(seconds, words)
        self.at(3.8, lambda: setattr(self, "hand", True))
        self.at(4.0, lambda: setattr(self, "speed", speed))
        return self

    def run(self) -> int:
        """Runs the loop to its end."""
        return self.loop.run()

    def frames(self, kind: int, since: float = 0.0) -> list[tuple[float, int]]:
        """(seconds since the start, argument) of the frames of a kind."""
        return [(time, argument) for time, argument in sent(self.wire, kind) if time >= since]

    def listen(self) -> None:
        """The policy takes the names of states that the guard told it."""
        while select.select([self.policy], [], [], 0)[0] and (state := self.policy.recv(100)):
            self.heard.append(state.decode())

    def records(self) -> list[dict]:
        """The black box."""
        self.black_box.close(10.0)
        return [json.loads(line) for line in self.log.read_text().splitlines()]

    def close(self) -> None:
        """Closes everything."""
        self.loop.close_link()
        self._keyboard.close()
        self.black_box.close(10.0)
        for one in (self.ours, self.policy, self.signals, self.kill):
            one.close()
        for descriptor in self._open_pipes:
            os.close(descriptor)
