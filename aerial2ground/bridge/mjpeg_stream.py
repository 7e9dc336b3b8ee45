"""Pictures of an MJPEG stream over HTTP (multipart/x-mixed-replace), each as soon as its last byte is there.

A picture's end is found in the JPEG itself, where its end marker cannot stand inside the coded picture: streams with a
Content-Length, without one, or with a wrong one are read alike, and none waits for the boundary after a picture.
"""

import base64
import contextlib
import http.client
import socket
import threading
import time
from collections.abc import Iterator
from urllib.parse import unquote, urlsplit

import cv2
import numpy as np
from jaxtyping import UInt8

from hashnerf.errors import UserError

START, END = b"\xff\xd8\xff", b"\xff\xd9"
AS_IT_IS = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
"""Never turned by what the file says of the camera's posture: the calibration is of the pixels."""
START_OF_SCAN = 0xDA
PIECE = 1 << 20
"""Bytes read at once: whatever has arrived, so that a reader that was held up finds the newest picture at once."""
LARGEST = 1 << 24
"""Bytes of one picture; more is no picture."""

Arrival = tuple[UInt8[np.ndarray, "h w 3"], float]
"""An RGB picture, and when its last byte arrived, monotonic seconds."""


class MjpegStream:
    """The pictures of one address, for one thread; `close` may be called by any other."""

    def __init__(self, url: str, shown: str, timeout: float):
        """`shown` names the address in messages (without a password); connecting may take `timeout` seconds."""
        self._url, self._shown, self._timeout = url, shown, timeout
        self._closed = threading.Event()
        self._socket: socket.socket | None = None

    def close(self) -> None:
        """Ends the stream; a thread that waits for its next picture is woken."""
        self._closed.set()
        if self._socket is not None:
            with contextlib.suppress(OSError):  # the other side was faster
                self._socket.shutdown(socket.SHUT_RDWR)

    def __iter__(self) -> Iterator[Arrival]:
        """Yields the newest picture that has arrived; those that came before it are passed over.

        Waits as long as the stream is silent; ends when it ends. Raises UserError where the address cannot be reached,
        refuses, or streams something else.
        """
        response = self._response()
        try:
            buffer = b""
            while not self._closed.is_set():
                piece = response.read1(PIECE)
                taken = time.monotonic()
                if not piece:
                    return
                newest, buffer = newest_jpeg(buffer + piece)
                picture = cv2.imdecode(np.frombuffer(newest, np.uint8), AS_IT_IS) if newest else None
                if picture is not None:
                    yield cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), taken
                if len(buffer) > LARGEST:
                    raise UserError(f"{self._shown}: sends over {LARGEST >> 20} MB without a picture; is it MJPEG?")
        except (OSError, http.client.HTTPException):
            return  # broken off: it has ended
        finally:
            response.close()
            if self._socket is not None:
                self._socket.close()

    def _response(self) -> http.client.HTTPResponse:
        parts = urlsplit(self._url)
        kind = http.client.HTTPSConnection if parts.scheme == "https" else http.client.HTTPConnection
        headers = {}
        if parts.username is not None:
            secret = f"{unquote(parts.username)}:{unquote(parts.password or '')}".encode()
            headers["Authorization"] = f"Basic {base64.b64encode(secret).decode()}"
        try:
            connection = kind(parts.hostname or "", parts.port, timeout=self._timeout)
            connection.connect()
            self._socket = connection.sock
            if self._closed.is_set():  # closed before there was anything to shut down
                connection.sock.shutdown(socket.SHUT_RDWR)
            target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
            connection.request("GET", target, headers=headers)
            response = connection.getresponse()
        except (OSError, ValueError, http.client.HTTPException) as error:
            # a wrong address is not repeated, there may be a password in it
            words = "it is no address" if isinstance(error, ValueError) else str(error)
            reason = getattr(error, "strerror", None) or words or type(error).__name__
            raise UserError(f"{self._shown}: cannot be opened ({reason}); check the address and the camera") from error
        kind_of_content = response.headers.get_content_type()
        if response.status != 200 or not kind_of_content.startswith("multipart/"):
            self._socket.close()
            raise UserError(
                f"{self._shown}: answers {response.status} {response.reason} with {kind_of_content}, not an MJPEG "
                "stream (multipart/x-mixed-replace); check the address"
            )
        self._socket.settimeout(None)  # silence is a camera that stalls, and no error
        return response


def newest_jpeg(data: bytes) -> tuple[bytes | None, bytes]:
    """Returns the last whole JPEG in `data` (None without one), and what follows it, the start of the next one."""
    newest, place = None, 0
    while (start := data.find(START, place)) >= 0:
        end = jpeg_end(data, start)
        if end is None:
            return newest, data[start:]
        if end > 0:
            newest = data[start:end]
        place = end or start + len(START)
    return newest, data[max(place, len(data) - len(START) + 1) :]


def jpeg_end(data: bytes, start: int) -> int | None:
    """Returns where the JPEG that starts at `start` ends; None where it is not whole yet, 0 where it is no JPEG.

    Segments are skipped by their lengths: a preview picture in one of them has an end marker of its own.
    """
    place = start + 2
    while place + 4 <= len(data):
        if data[place] != 0xFF:
            return 0
        if data[place + 1] == 0xFF:  # filling
            place += 1
        elif data[place + 1] == START_OF_SCAN:
            end = data.find(END, place + 4)
            return end + len(END) if end >= 0 else None
        else:
            place += 2 + int.from_bytes(data[place + 2 : place + 4], "big")
    return None
