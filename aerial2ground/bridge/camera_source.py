"""The newest picture of a camera, and when it arrived; never an old picture as a new one.

A thread reads a device, a video file or a stream and keeps one picture. When the device stalls, nothing comes; when it
ends or is unplugged, `wait` raises. OpenCV reads devices, files and RTSP, of which a silence of 2 s is the end. MJPEG
over HTTP is read by `mjpeg_stream`: OpenCV gives out streams without Content-Length one picture late (measured: 54 ms
at 20 pictures a second). What a network holds back before it arrives, no reader can know: keep pictures small for it.
"""

import re
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from aerial2ground.bridge.mjpeg_stream import Arrival, MjpegStream
from hashnerf.errors import UserError

OPENING = 2.0
"""Seconds in which the first picture must come."""
CLOSING = 1.0
"""Seconds that closing waits for the reading thread; a device that hangs is left to the end of the process."""


class CameraError(UserError):
    """The camera is not there, gives no pictures, or has ended; the message names it."""


@dataclass(frozen=True)
class Shot:
    """One picture."""

    number: int
    """Counts the pictures that arrived, from 1; those that came too fast to be used count too."""
    picture: UInt8[np.ndarray, "h w 3"]
    """Red, green, blue; nobody writes into it any more."""
    taken: float
    """When it had arrived whole and was not yet decoded, monotonic seconds."""


class CameraSource:
    """Keeps the newest of `pictures`, which a thread of its own reads."""

    def __init__(self, source: str, pictures: Iterable[Arrival], stop: Callable[[], None]):
        """`source` names the camera in messages; `stop` makes `pictures` end soon."""
        self._source, self._pictures, self._stop = source, pictures, stop
        self._changed = threading.Condition()
        self._newest: Shot | None = None
        self._error: CameraError | None = None
        self._thread = threading.Thread(target=self._read, name=f"camera {source}", daemon=True)
        self._thread.start()

    def wait(self, after: int, timeout: float) -> Shot | None:
        """Returns the newest picture whose number is above `after`, or None where none came within `timeout` seconds.

        Raises CameraError once the camera has ended and its last picture has been given out.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._error or self._number() > after, timeout)
            if self._number() > after:
                return self._newest
            if self._error:
                raise self._error
            return None

    def close(self) -> None:
        """Ends the thread; the last picture stays readable."""
        self._stop()
        self._thread.join(CLOSING)

    def __enter__(self) -> "CameraSource":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _number(self) -> int:
        return self._newest.number if self._newest else 0

    def _read(self) -> None:
        try:
            for picture, taken in self._pictures:
                with self._changed:
                    self._newest = Shot(self._number() + 1, picture, taken)
                    self._changed.notify_all()
            error = CameraError(f"{self._source}: the camera has ended; connect it again and start anew")
        except UserError as failure:
            error = CameraError(str(failure))
        except Exception as failure:  # in a thread it would be lost, and the camera would only seem to stall
            error = CameraError(f"{self._source}: cannot be read any more ({type(failure).__name__}: {failure})")
        with self._changed:
            self._error = error
            self._changed.notify_all()


def open_camera(source: str, width: int = 0, height: int = 0) -> CameraSource:
    """Opens a device ("0", "/dev/video0"), a video file, or an http(s) MJPEG or rtsp URL, and waits for one picture.

    A device is asked for pictures of `width` x `height` pixels where these are given. A video file plays at its own
    frame rate. Raises CameraError, naming the source, where no picture comes within 2 s.
    """
    shown = re.sub("//.*@", "//", source).partition("?")[0]  # without passwords
    pictures, stop = _pictures(source, shown, width, height)
    camera = CameraSource(shown, pictures, stop)
    try:
        if camera.wait(0, OPENING) is None:
            raise CameraError(f"{shown}: gives no picture within {OPENING:g} s; check the camera and its address")
    except UserError:
        camera.close()
        raise
    return camera


def _pictures(source: str, shown: str, width: int, height: int) -> tuple[Iterable[Arrival], Callable[[], None]]:
    """Returns the pictures of a source, and what makes them end; raises CameraError where there is no such source."""
    if source.startswith(("http://", "https://")):
        stream = MjpegStream(source, shown, OPENING)
        return stream, stream.close
    stop = threading.Event()
    if source.startswith(("rtsp://", "rtsps://")):
        return _captured(shown, lambda: _stream_capture(source), stop), stop.set
    path = Path(f"/dev/video{source}" if source.isdecimal() else source)
    if source.isdecimal() and not path.exists():
        raise CameraError(f"{source}: there is no device {path}; connect the camera or give another number")
    if path.is_char_device():
        return _captured(source, lambda: _device_capture(str(path), width, height), stop), stop.set
    if not path.is_file():
        raise CameraError(f"{source}: no such video file or device; give a device, a file or an http or rtsp address")
    return _video(source, stop), stop.set


def _device_capture(device: str, width: int, height: int) -> cv2.VideoCapture:
    capture = cv2.VideoCapture(device, cv2.CAP_V4L2)
    if width and height:
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, width)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, height)
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # what waits in a queue grows old
    return capture


def _stream_capture(source: str) -> cv2.VideoCapture:
    limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, int(1000 * OPENING), cv2.CAP_PROP_READ_TIMEOUT_MSEC, int(1000 * OPENING)]
    return cv2.VideoCapture(source, cv2.CAP_FFMPEG, limits)


def _captured(shown: str, opened: Callable[[], cv2.VideoCapture], stop: threading.Event) -> Iterator[Arrival]:
    """Yields what OpenCV reads, until it reads nothing more."""
    capture = opened()
    try:
        if not capture.isOpened():
            raise CameraError(f"{shown}: cannot be opened; is another program using it, and may you read it?")
        while not stop.is_set() and capture.grab():
            taken = time.monotonic()
            good, picture = capture.retrieve()
            if not good:
                return
            yield cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), taken
    finally:
        capture.release()


def _video(source: str, stop: threading.Event) -> Iterator[Arrival]:
    """Yields the pictures of a file, each when its time has come."""
    capture = cv2.VideoCapture(source, cv2.CAP_FFMPEG)
    rate = capture.get(cv2.CAP_PROP_FPS) if capture.isOpened() else 0.0
    try:
        if not 0 < rate < 1000:
            raise CameraError(f"{source}: is no video that can be read; give a video file")
        start, number = time.monotonic(), 0
        while not stop.wait(max(0.0, start + number / rate - time.monotonic())):
            taken = time.monotonic()
            good, picture = capture.read()
            if not good:
                if number == 0:
                    raise CameraError(f"{source}: is no video that can be read; give a video file")
                raise CameraError(f"{source}: the video has ended; start anew or give a longer one")
            number += 1
            yield cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), taken
    finally:
        capture.release()
