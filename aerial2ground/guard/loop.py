"""The guard's loop: everything that can happen is looked at between two periods of 20 ms, and never waited for."""

import contextlib
import io
import math
import queue
import select
import socket
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from aerial2ground.guard.black_box import BlackBox
from aerial2ground.guard.guard import OLDEST_FIRMWARE, Guard
from aerial2ground.guard.messages import SIZE
from aerial2ground.guard.operator_input import Datagrams, Joystick, Keyboard, StopFile
from aerial2ground.guard.serial_link import LinkBlocked, LinkLost, SerialLink
from aerial2ground.guard.set_point import PERIOD
from aerial2ground.guard.states import State
from aerial2ground.guard.vesc import FrameParser
from hashnerf.errors import UserError

FIRMWARE_SECONDS, END_SECONDS = 0.7, 0.9
FIRST_RETRY, LAST_RETRY = 0.5, 5.0
MOST_MESSAGES = 100
"""Taken in one go, so that a policy that floods us does not hold up the loop."""
MOST_HAPPENINGS = 300
"""Taken in one period; what is more is a flood, of which only stops are heard."""
STOPS = ("estop", "stop", "released")
MOST_SENTENCES = 1000
SAME_AGAIN = 1.0
"""Seconds in which a sentence is not said again."""
POLICY_DECIDES = -1
MOVING = (State.ARMED, State.STOPPING)


class Announcer:
    """Prints sentences from a thread: a terminal that hangs must not hold up the loop."""

    def __init__(self, stream: io.TextIOBase):
        self._queue: queue.Queue[str | None] = queue.Queue(MOST_SENTENCES)
        self._thread = threading.Thread(target=self._run, args=(stream,), daemon=True)
        self._thread.start()

    def say(self, sentence: str) -> None:
        """Queues a sentence; it is lost where too many wait already."""
        self.echo(sentence + "\n")

    def echo(self, text: str) -> None:
        """Queues what was typed."""
        with contextlib.suppress(queue.Full):
            self._queue.put_nowait(text)

    def close(self) -> None:
        """Prints what is queued, if that does not take long."""
        with contextlib.suppress(queue.Full):
            self._queue.put_nowait(None)
        self._thread.join(0.3)

    def _run(self, stream: io.TextIOBase) -> None:
        while (text := self._queue.get()) is not None:
            with contextlib.suppress(OSError, ValueError):  # a closed terminal does not end a drive
                stream.write(text)
                stream.flush()


@dataclass
class Loop:
    """Everything that the loop looks at."""

    guard: Guard
    port: str
    """Empty: none is opened."""
    policy: socket.socket
    inputs: list[Keyboard | Datagrams]
    polled: Sequence[Keyboard | Joystick | StopFile]
    signals: socket.socket
    black_box: BlackBox
    say: Callable[[str], None]
    clock: Callable[[], float] = time.monotonic
    greeting: list[str] = field(default_factory=list)
    """Said when the policy is loaded and there is a motor controller, where one is wanted."""
    link: SerialLink | None = None
    status: int | None = None
    """What the process will end with, once something ends it."""
    _policy_ended: bool = False
    _was_connected: bool = False
    _parser: FrameParser = field(default_factory=FrameParser)
    _retry_at: float = math.inf
    _retry_after: float = FIRST_RETRY
    _ends_at: float = math.inf
    _reports_at: float = 0.0
    _looked: float = math.inf
    _said: dict[str, float] = field(default_factory=dict)
    """When each sentence was said last."""
    _happened: list = field(default_factory=list)
    """What the guard took in since the last cycle, for the black box."""

    def run(self) -> int:
        """Runs until something ends it and the car stands; returns `status`.

        Raises UserError where the port cannot be used, or no motor controller answers, at the start.
        """
        start = following = self.clock()
        if self.port:
            self._open(start)
        while self.status is None or (self.guard.state in MOVING and self.clock() < self._ends_at):
            before = self.guard.state, self.guard.fault
            self._listen(max(0.0, following - self.clock()))
            now = self.clock()
            if now >= following:
                following = max(following + PERIOD, now)
                self._poll(now)
            elif before == (self.guard.state, self.guard.fault):
                continue  # nothing that cannot wait for the next period
            self._cycle(now)
            self._require_controller(now - start)
        self._cycle(self.clock())  # the state after the stop sequence has its frames, too
        return self.status

    def close_link(self) -> None:
        """Closes the port."""
        if self.link is not None:
            self.link.close()
            self.link = None

    def _take(self, kind: str, value: str, now: float) -> None:
        if len(self._happened) >= MOST_HAPPENINGS and kind in ("word", "message", "payload") and value not in STOPS:
            return
        self._happened.append([now, kind, value])
        self.guard.take(kind, value, now)

    def _end(self, status: int, now: float, kind: str = "word", value: str = "stop") -> None:
        """Stops the car; what ends the process first decides what it ends with."""
        if self.status is None:
            self.status, self._ends_at = status, now + END_SECONDS
            self._take(kind, value, now)

    def _listen(self, seconds: float) -> None:
        """Waits until something can be read, and reads it."""
        readers = [self.signals, *self.inputs]
        if not self._policy_ended:
            readers.append(self.policy)
        if self.link is not None:
            readers.append(self.link)
        readable = select.select(readers, [], [], seconds)[0]
        now = self.clock()
        latest, self._looked = self._looked + PERIOD, now
        for reader in readable:
            if reader is self.signals:
                self._end(128 + self.signals.recv(1)[0], now)
            elif reader is self.policy:
                self._read_policy(now)
            elif reader is self.link:
                self._read_link(now)
            else:
                self._read_words(reader, now, latest)

    def _read_policy(self, now: float) -> None:
        with contextlib.suppress(BlockingIOError):
            for _ in range(MOST_MESSAGES):
                message = self._receive()
                if not message:
                    self._policy_ended = True
                    if self.guard.policy_ready:
                        self._end(POLICY_DECIDES, now, "fault", "POLICY_GONE")
                    self._end(POLICY_DECIDES, now)
                    return
                self._take("message", message.hex(), self.clock())  # it may have been sent after `now`
        with contextlib.suppress(OSError):  # it is told again next time
            self.policy.send(self.guard.state.value.encode())

    def _receive(self) -> bytes:
        try:
            return self.policy.recv(SIZE + 1)
        except ConnectionError:
            return b""

    def _read_words(self, reader: Keyboard | Datagrams, now: float, latest: float) -> None:
        for word in reader.read():
            if word in ("quit", "closed"):
                self._end(0, now)
            else:
                # one that waited while we slept tells of a hand of that time, not of now
                self._take("word", word, min(now, latest) if word == "held" else now)
            if word == "closed":
                self.inputs.remove(reader)
                self.say("standard input is closed: nobody could stop the car, so this ends")

    def _read_link(self, now: float) -> None:
        try:
            data = self.link.read()
        except LinkLost:
            self._lose_link(now)
            return
        for payload in self._parser.feed(data, now):
            self._take("payload", payload.hex(), now)

    def _poll(self, now: float) -> None:
        """What has to be asked for, once a period."""
        for one in self.polled:
            for word in one.poll():
                self._take("word", word, now)
        if now >= self._retry_at:
            try:
                self._open(now)
            except UserError:
                self._retry_after = min(2 * self._retry_after, LAST_RETRY)
                self._retry_at = now + self._retry_after
        if now >= self._reports_at and (not self.port or self.guard.state is State.ARMED):
            self._reports_at = now + 1
            self._report(now)

    def _report(self, now: float) -> None:
        """Tells the operator what is driven by, once a second while the car drives, and in a dry run."""
        command, values = self.guard.commands.command, self.guard.controller.values
        if command is not None:
            sentence = f"steering {command.steering:+.3f} rad, picture {1000 * (now - command.taken):.0f} ms old"
            if values is not None:
                sentence += f", {self.guard.controller.speed(now):.2f} m/s, {values.voltage:.1f} V"
            self.say(sentence)

    def _cycle(self, now: float) -> None:
        """What the guard says to it, goes out."""
        if self.guard.policy_ready and (self.guard.firmware is not None or not self.port):
            for sentence in self.greeting:
                self.say(sentence)
            self.greeting.clear()
        frames = b"".join(self.guard.tick(now))
        self._record(frames, now)
        if frames:
            self._write(frames, now)
        for note in self.guard.notes:
            if now - self._said.get(note, -math.inf) >= SAME_AGAIN:
                self.say(note)
                self._said[note] = now
        self.guard.notes.clear()
        if len(self._said) > MOST_SENTENCES:
            self._said.clear()

    def _write(self, frames: bytes, now: float) -> None:
        try:
            self.link.write(frames)
        except LinkBlocked:
            self._take("fault", "LINK_BLOCKED", now)
            self._drop_waiting(now)
        except LinkLost:
            self._lose_link(now)

    def _drop_waiting(self, now: float) -> None:
        try:
            self.link.drop_waiting()
        except LinkLost:
            self._lose_link(now)

    def _open(self, now: float) -> None:
        self.link = SerialLink(self.port)
        self._parser = FrameParser()
        self._retry_at, self._retry_after = math.inf, FIRST_RETRY
        self._take("link", "up", now)

    def _lose_link(self, now: float) -> None:
        self.close_link()
        self._retry_at = now + self._retry_after
        self._take("link", "down", now)

    def _require_controller(self, seconds: float) -> None:
        """A port without a motor controller is refused at the start; later it is a fault."""
        firmware = self.guard.firmware
        if not self.port or self._was_connected:
            return
        if firmware is not None and firmware[0] < OLDEST_FIRMWARE:
            raise UserError(
                f"{self.port}: the controller's firmware {firmware[0]}.{firmware[1]} speaks another protocol; "
                f"update it to {OLDEST_FIRMWARE} or newer with VESC Tool"
            )
        self._was_connected = firmware is not None
        if not self._was_connected and seconds > FIRMWARE_SECONDS:
            raise UserError(f"{self.port}: nothing there answers as a VESC does; give the motor controller's port")

    def _record(self, frames: bytes, now: float) -> None:
        guard, command, values = self.guard, self.guard.commands.command, self.guard.controller.values
        self.black_box.add(
            {
                "t": now,
                "in": self._happened,
                "state": guard.state.value,
                "fault": guard.fault and guard.fault.name,
                "out": frames.hex(),
                "steering": guard.point.steering,
                "speed": guard.point.speed,
                "number": command and command.number,
                "wanted": command and [command.steering, command.speed],
                "picture_age": command and now - command.taken,
                "erpm": values.erpm if values and guard.controller.speed(now) < math.inf else None,
                "volts": values and values.voltage,
            }
        )
        self._happened = []
