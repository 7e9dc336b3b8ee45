"""A rig for the whole bridge: a fake motor controller, a moving picture, and the bridge's own processes beside them.

The bridge is started by its script, as an operator would, and hears the rig through its standard input; what it does is
read from the bytes that reach the fake controller.
"""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from aerial2ground.bridge.fake_vesc import FakeVesc
from aerial2ground.bridge.picture_stream import PictureStream, encoded
from aerial2ground.bridge.trial_policies import Kind, trial_policy
from aerial2ground.bridge.wire import first_brake_after
from aerial2ground.guard.arming import WHEELS
from hashnerf.errors import UserError

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "scripts" / "deploy_racecar.py"
WIDTH, HEIGHT, RATE = 48, 27, 30
LOOKING = 2 * WHEELS + 0.3
"""Seconds for which the wheels are turned, and a little."""
PATIENCE = 20.0
"""Seconds in which anything that the rig waits for must have come: far more than it takes on a busy machine."""


class MovingPicture:
    """A thread that shows pictures of noise, each new, 30 a second."""

    def __init__(self, stream: PictureStream):
        self.stream = stream
        self.black = False
        """Whether the pictures are black."""
        self.paused = False
        """Whether none are shown."""
        self.size = (HEIGHT, WIDTH)
        """Rows and columns."""
        self.times: dict[int, float] = {}
        """When each picture was taken, by the CRC-32 of what a client decodes: noise has no two that are the same."""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ends the thread."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        random = np.random.default_rng(0)
        following = time.monotonic()
        while not self._stop.wait(max(0.0, following - time.monotonic())):
            following = max(following + 1 / RATE, time.monotonic())
            picture = random.integers(0, 256, (*self.size, 3), dtype=np.uint8)
            if not self.paused:
                self._show(picture * 0 if self.black else picture)

    def _show(self, picture: UInt8[np.ndarray, "h w 3"]) -> None:
        taken = time.monotonic()
        self.stream.show(picture, taken)
        # after it was sent: looking it up later costs the picture no time
        seen = cv2.imdecode(np.frombuffer(encoded(picture), np.uint8), cv2.IMREAD_COLOR_RGB)
        self.times[zlib.crc32(seen.data)] = taken


class BridgeProcess:
    """The bridge as an operator starts it, spoken to through its standard input; a context manager."""

    def __init__(self, command: Sequence[str], start: bool = True):
        """`command` starts the bridge, at once if `start`."""
        self.command = list(command)
        self.heard: list[tuple[float, str]] = []
        """What the bridge said, line by line, and when it was read."""
        self.bridge: subprocess.Popen | None = None
        self._holds = threading.Event()
        self._closing = threading.Event()
        self._threads: list[threading.Thread] = []
        if start:
            self.start()

    def __enter__(self) -> "BridgeProcess":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def start(self) -> None:
        """Starts the bridge."""
        self.bridge = subprocess.Popen(
            self.command,
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            bufsize=0,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
        )
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._read, self._hold)]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Ends it, if need be by force."""
        self._closing.set()
        if self.bridge is None:
            return
        for process in (self.bridge.pid, self.policy_process()):
            with contextlib.suppress(ProcessLookupError, TypeError):
                os.kill(process, signal.SIGKILL)
        self.bridge.wait()
        for thread in self._threads:
            thread.join()
        self.bridge.stdin.close()
        self.bridge.stdout.close()

    def say(self, word: str) -> None:
        """Says a word to the bridge."""
        self._write(word.encode() + b"\n")

    def press(self, key: str) -> None:
        """Presses one key."""
        self._write(key.encode())

    def hold(self, holds: bool) -> None:
        """Takes the dead-man, or lets it go."""
        (self._holds.set if holds else self._holds.clear)()

    def said(self, words: str, since: float = 0.0) -> float | None:
        """Returns when the bridge said a line with these words, after `since`; None if it has not."""
        return next((moment for moment, line in self.heard if moment >= since and words in line), None)

    def wait_for(self, what: Callable[[], object], why: str) -> None:
        """Waits until `what` is true; raises UserError, with what the bridge said, where that never happens."""
        ends = time.monotonic() + PATIENCE
        while not what():
            if time.monotonic() > ends:
                said = "\n".join(line for _, line in self.heard[-20:])
                raise UserError(f"the bridge: {why} did not happen within {PATIENCE:g} s; it said:\n{said}")
            time.sleep(0.005)

    def wait_for_words(self, words: str, since: float = 0.0) -> None:
        """Waits until the bridge says them."""
        self.wait_for(lambda: self.said(words, since), f"'{words}'")

    def confirm_wheels(self) -> None:
        """Has the wheels turned and says yes."""
        self.wait_for_words("the motor controller")
        begun = time.monotonic()
        self.say("check")
        self.wait_for_words("the wheels turn left", begun)
        time.sleep(LOOKING)
        self.say("yes")
        self.wait_for_words("good", begun)

    def arm(self) -> None:
        """Arms the car and takes the dead-man; the wheels must have been confirmed."""
        begun = time.monotonic()
        while self.said("-> READY", begun) is None:
            self.say("arm")
            time.sleep(0.1)
            self.wait_for(lambda: time.monotonic() < begun + PATIENCE, "arming")
        self.hold(True)
        self.wait_for_words("-> ARMED", begun)

    def policy_process(self) -> int | None:
        """Returns the number of the policy's process; None where there is none."""
        for entry in Path("/proc").iterdir():
            if entry.name.isdecimal():
                with contextlib.suppress(OSError, IndexError):
                    parent = (entry / "stat").read_text().rpartition(")")[2].split()[1]
                    if parent == str(self.bridge.pid):
                        return int(entry.name)
        return None

    def _write(self, data: bytes) -> None:
        with contextlib.suppress(BrokenPipeError, ValueError):  # it has ended
            self.bridge.stdin.write(data)

    def _read(self) -> None:
        for line in self.bridge.stdout:
            self.heard.append((time.monotonic(), line.decode(errors="replace").rstrip()))

    def _hold(self) -> None:
        while not self._closing.wait(0.03):
            if self._holds.is_set():
                self._write(b"g")


class Rig(BridgeProcess):
    """The bridge with everything around it: motor controller, camera, trial policy."""

    def __init__(
        self, folder: Path, arguments: Sequence[str] = (), policy: Kind | Path = "constant", start: bool = True
    ):
        """Starts everything in `folder`; `arguments` go to the script, `policy` is a kind of trial policy or a file."""
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self.vesc = FakeVesc(link=folder / "car")
        self.stream = PictureStream()
        self.picture = MovingPicture(self.stream)
        trial = not isinstance(policy, Path)
        file = trial_policy(folder / "policy.onnx", policy, WIDTH, HEIGHT) if trial else policy.resolve()
        command = deploy_command(file, folder / "car", self.stream.url, ROOT / "configs/cars/mini_city.yaml")
        super().__init__([*command, "--speed", "0.8", "--log", str(folder / "log"), *arguments], start)

    def __enter__(self) -> "Rig":
        return self

    def close(self) -> None:
        """Ends everything."""
        super().close()
        self.picture.close()
        self.stream.close()
        self.vesc.close()

    def arm(self, speed: float = 0.5) -> None:
        """Arms the car and waits until it drives with `speed` (m/s)."""
        super().arm()
        self.wait_for(lambda: self.vesc.state.speed >= speed, f"a speed of {speed} m/s")

    def first_brake(self, since: float, within: float) -> float:
        """Returns seconds from `since` to the first brake frame that no motion follows; waits `within` s and more."""
        time.sleep(max(0.0, since + within + 0.6 - time.monotonic()))
        return first_brake_after(self.vesc.received, since)


def deploy_command(policy: Path, port: Path | str, camera: str, car: Path) -> list[str]:
    """Returns the command that starts the bridge."""
    options = {"policy": policy, "port": port, "camera": camera, "car": car}
    return [sys.executable, str(SCRIPT), *(str(part) for key, value in options.items() for part in (f"--{key}", value))]
