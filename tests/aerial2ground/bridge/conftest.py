"""Small policies with known answers, and a camera on the network that goes on showing its picture."""

import contextlib
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from aerial2ground.bridge.picture_stream import PictureStream
from aerial2ground.bridge.trial_policies import trial_policy


@pytest.fixture
def onnx_policy(tmp_path) -> Callable[..., Path]:
    """`onnx_policy(kind, width, height, ...)` writes a policy of `trial_policies` and returns its path."""

    def write(kind: str, width: int, height: int, *arguments: float, **options: float) -> Path:
        return trial_policy(tmp_path / f"{kind}.onnx", kind, width, height, *arguments, **options)

    return write


class Showing:
    """A stream that is shown `picture` again every few milliseconds, with a pixel that differs each time."""

    def __init__(self, stream: PictureStream, picture: np.ndarray):
        self.stream, self.picture = stream, picture
        self.counting = True
        """Whether the first pixels differ from picture to picture."""
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._show)
        self._thread.start()

    def _show(self) -> None:
        number = 0
        while not self._ended.wait(0.01):
            number += 1
            picture = self.picture.copy()
            if self.counting:
                picture[:8, :8] = number * 16 % 256
            self.stream.show(picture)

    def stop(self) -> None:
        """Shows nothing more."""
        self._ended.set()
        self._thread.join()


@pytest.fixture
def showing() -> Iterator[Callable[[np.ndarray], Showing]]:
    """`showing(picture)` starts a camera on the network that shows it all the time."""
    with contextlib.ExitStack() as stack:

        def start(picture: np.ndarray) -> Showing:
            stream = stack.enter_context(PictureStream())
            shown = Showing(stream, picture)
            stack.callback(shown.stop)
            return shown

        yield start
