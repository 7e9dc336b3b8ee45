"""A camera on the network: pictures as JPEG files one after the other over HTTP (multipart/x-mixed-replace).

Each part says how long it is and when its picture was taken (X-Timestamp, monotonic seconds of this machine).
"""

import contextlib
import socket
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Literal

import cv2
import numpy as np
from jaxtyping import UInt8

BOUNDARY = "picture"
QUALITY = 95

Freeze = Literal["no", "still", "repeat"]


def encoded(picture: UInt8[np.ndarray, "h w 3"]) -> bytes:
    """Returns an RGB picture as JPEG with colours as fine as brightness."""
    settings = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
    settings += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    whole, data = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), settings)
    assert whole
    return data.tobytes()


class PictureStream:
    """Serves the pictures it is shown on 127.0.0.1; a context manager. Every client gets each new picture at once."""

    def __init__(self, port: int = 0) -> None:
        self._changed = threading.Condition()
        self._jpeg, self._taken, self._number = b"", 0.0, 0
        self._freeze: Freeze = "no"
        self._clients: set[socket.socket] = set()
        self._server: _Server | None = None
        self._thread: threading.Thread | None = None
        self._port = port
        self._serve()

    def __enter__(self) -> "PictureStream":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def url(self) -> str:
        """Where the pictures are."""
        return f"http://127.0.0.1:{self._port}/"

    @property
    def clients(self) -> int:
        """How many are watching."""
        with self._changed:
            return len(self._clients)

    def show(self, picture: UInt8[np.ndarray, "h w 3"], taken: float | None = None) -> None:
        """Sends a new RGB picture to everybody who watches; `taken` is monotonic seconds, now if not given."""
        moment = time.monotonic() if taken is None else taken
        jpeg = encoded(picture)
        with self._changed:
            if self._freeze == "still":
                return
            if self._freeze == "no" or not self._number:
                self._jpeg = jpeg
            self._taken, self._number = moment, self._number + 1
            self._changed.notify_all()

    def freeze(self, kind: Literal["still", "repeat"]) -> None:
        """Sends nothing more (still), or the last picture as if it were new whenever one is shown (repeat)."""
        with self._changed:
            self._freeze = kind

    def unplug(self) -> None:
        """Closes all connections and takes no new ones."""
        server, self._server = self._server, None
        if server is None:
            return
        server.shutdown()
        with self._changed:
            server.closing = True
            for client in self._clients:
                with contextlib.suppress(OSError):  # it may have gone by itself
                    client.shutdown(socket.SHUT_RDWR)
            self._changed.notify_all()
        server.server_close()  # waits for the threads of the clients
        assert self._thread is not None
        self._thread.join()

    def resume(self) -> None:
        """Ends every fault: new pictures flow, at the same address."""
        with self._changed:
            self._freeze = "no"
        if self._server is None:
            self._serve()

    def close(self) -> None:
        """Stops serving."""
        self.unplug()

    def _serve(self) -> None:
        self._server = _Server(self, self._port)
        self._port = self._server.server_address[1]
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True)
        self._thread.start()

    def send_to(self, client: "_Handler") -> None:
        """Sends every new picture to one client until it leaves or is cut off."""
        with self._changed:
            if client.server.closing:
                return
            self._clients.add(client.connection)
            seen = self._number
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: client.server.closing or self._number > seen)  # noqa: B023
                    if client.server.closing:
                        return
                    seen, jpeg, taken = self._number, self._jpeg, self._taken
                head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n"
                client.wfile.write(f"{head}X-Timestamp: {taken:.6f}\r\n\r\n".encode() + jpeg + b"\r\n")
        except OSError:
            return  # the client has gone
        finally:
            with self._changed:
                self._clients.discard(client.connection)


class _Server(ThreadingHTTPServer):
    """A server that knows its stream, says when it is closing, and waits for its threads."""

    daemon_threads = False

    def __init__(self, stream: PictureStream, port: int) -> None:
        self.stream, self.closing = stream, False
        super().__init__(("127.0.0.1", port), _Handler)

    def handle_error(self, request: object, client_address: object) -> None:
        """Says nothing: clients come and go."""


class _Handler(BaseHTTPRequestHandler):
    """One client."""

    server: _Server
    disable_nagle_algorithm = True
    timeout = 10  # seconds for a request that never comes, or a client that takes nothing

    def do_GET(self) -> None:
        """Answers with pictures without end."""
        self.send_response(200)
        self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.server.stream.send_to(self)

    def log_message(self, *words: object) -> None:
        """Says nothing."""
