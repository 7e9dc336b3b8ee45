"""Pictures over HTTP: every new one at once, never an old one, and what goes wrong with cameras."""

import os
import threading
import time
import urllib.error
import urllib.request
from contextlib import closing

import cv2
import numpy as np
import pytest

from aerial2ground.bridge.picture_stream import PictureStream, encoded


def grey(value):
    return np.full((27, 48, 3), value, np.uint8)


def eventually(condition, seconds=5.0):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.002)
    return condition()


class Client:
    """A plain reader of parts."""

    def __init__(self, stream, seconds=5.0):
        watching = stream.clients
        self.response = urllib.request.urlopen(stream.url, timeout=seconds)
        assert eventually(lambda: stream.clients == watching + 1)

    def close(self):
        self.response.close()

    def part(self):
        """Time stamp and bytes of the next picture; None at the end."""
        line = self.response.readline()
        if not line:
            return None
        assert line == b"--picture\r\n"
        head = {}
        while (line := self.response.readline()) != b"\r\n":
            key, value = line.decode().strip().split(": ")
            head[key] = value
        assert head["Content-Type"] == "image/jpeg"
        data = self.response.read(int(head["Content-Length"]))
        assert self.response.read(2) == b"\r\n"
        return float(head["X-Timestamp"]), data


def test_pictures_arrive_with_the_time_at_which_they_were_taken():
    with PictureStream() as stream, closing(Client(stream)) as client:
        assert client.response.headers["Content-Type"] == "multipart/x-mixed-replace; boundary=picture"
        for taken, value in ((1.5, 10), (2.25, 200)):
            stream.show(grey(value), taken)
            told, data = client.part()
            assert told == taken and data == encoded(grey(value))
        stream.show(grey(0))
        assert abs(time.monotonic() - client.part()[0]) < 60


def test_colours_survive_as_they_are():
    picture = np.zeros((27, 48, 3), np.uint8)
    picture[:, ::2] = (255, 0, 0)  # columns of red and blue, which halved colours would blend
    picture[:, 1::2] = (0, 0, 255)
    seen = cv2.cvtColor(cv2.imdecode(np.frombuffer(encoded(picture), np.uint8), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
    assert np.abs(seen.astype(int) - picture).max() < 40


def test_a_new_client_waits_for_a_new_picture_and_all_clients_get_it():
    with PictureStream() as stream:
        stream.show(grey(1), 1.0)
        with closing(Client(stream)) as first, closing(Client(stream)) as second:
            stream.show(grey(2), 2.0)
            assert first.part()[0] == 2.0 and second.part()[0] == 2.0
            stream.show(grey(3), 3.0)
            assert first.part()[0] == 3.0 and second.part()[0] == 3.0


def test_a_still_camera_sends_nothing():
    with PictureStream() as stream, closing(Client(stream)) as client:
        stream.freeze("still")
        stream.show(grey(1), 1.0)
        stream.show(grey(2), 2.0)
        stream.resume()
        stream.show(grey(3), 3.0)
        assert client.part()[0] == 3.0


def test_a_repeating_camera_sends_one_picture_with_new_times():
    with PictureStream() as stream, closing(Client(stream)) as client:
        stream.show(grey(1), 1.0)
        assert client.part() == (1.0, encoded(grey(1)))
        stream.freeze("repeat")
        for taken in (2.0, 3.0):
            stream.show(grey(200), taken)
            assert client.part() == (taken, encoded(grey(1)))
        stream.resume()
        stream.show(grey(200), 4.0)
        assert client.part() == (4.0, encoded(grey(200)))


def test_unplugged_it_is_gone_and_comes_back_at_the_same_address():
    with PictureStream() as stream, closing(Client(stream)) as client:
        stream.unplug()
        assert client.part() is None
        with pytest.raises(urllib.error.URLError):
            urllib.request.urlopen(stream.url, timeout=1)
        stream.show(grey(1), 1.0)  # nobody sees it, nothing breaks
        stream.unplug()
        url = stream.url
        stream.resume()
        assert stream.url == url
        with closing(Client(stream)) as again:
            stream.show(grey(2), 2.0)
            assert again.part()[0] == 2.0


def test_opencv_reads_it():
    stop = threading.Event()
    with PictureStream() as stream:

        def feed():
            while not stop.wait(0.01):
                stream.show(grey(77))

        feeder = threading.Thread(target=feed)
        feeder.start()
        capture = cv2.VideoCapture(stream.url)
        try:
            assert capture.isOpened()
            whole, picture = capture.read()
            assert whole and picture.shape == (27, 48, 3) and np.abs(picture.astype(int) - 77).max() <= 1
        finally:
            capture.release()
            stop.set()
            feeder.join()


def test_a_client_that_takes_nothing_does_not_hold_up_unplugging():
    noise = np.random.default_rng(0).integers(0, 256, (1800, 1800, 3), np.uint8)  # more than any socket keeps
    with PictureStream() as stream, closing(Client(stream)):
        stream.show(noise)
        time.sleep(0.1)
        start = time.monotonic()
        stream.unplug()
        assert time.monotonic() - start < 8, "a handler would give up after 10 s by itself"


def test_a_client_that_leaves_does_no_harm():
    with PictureStream() as stream:
        Client(stream).close()

        def gone():
            stream.show(grey(1))
            return stream.clients == 0

        assert eventually(gone)
        with closing(Client(stream)) as client:
            stream.show(grey(2), 2.0)
            assert client.part()[0] == 2.0


def test_nothing_is_left_behind():
    def own():
        return len(os.listdir("/proc/self/fd")), threading.active_count()

    before = own()
    with PictureStream() as stream:
        client = Client(stream)
        stream.show(grey(1))
    client.close()
    assert own() == before
