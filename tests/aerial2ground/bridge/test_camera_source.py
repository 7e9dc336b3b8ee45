"""Cameras that show, stall, freeze, end, or were never there; no old picture is ever new."""

import contextlib
import socket
import threading
import time

import cv2
import numpy as np
import pytest

from aerial2ground.bridge import camera_source
from aerial2ground.bridge.camera_source import CameraError, CameraSource, open_camera
from aerial2ground.bridge.picture_stream import PictureStream

RED = np.full((27, 48, 3), (200, 30, 10), np.uint8)


@pytest.fixture(autouse=True)
def no_thread_stays():
    """Every thread that a test starts ends with it."""
    before = set(threading.enumerate())
    yield
    for thread in set(threading.enumerate()) - before:
        thread.join(5)
        assert not thread.is_alive(), thread.name


def video(path, levels, rate=50.0):
    """A small video of grey pictures."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), rate, (64, 48))
    assert writer.isOpened()
    for level in levels:
        writer.write(np.full((48, 64, 3), level, np.uint8))
    writer.release()
    return str(path)


def test_pictures_of_a_stream_in_the_right_colours(showing):
    shown = showing(RED)
    start = time.monotonic()
    with open_camera(shown.stream.url) as camera:
        first = camera.wait(0, 5.0)
        second = camera.wait(first.number, 5.0)
        assert second.number > first.number and start < first.taken < second.taken <= time.monotonic()
        assert first.picture.dtype == np.uint8 and first.picture.shape == (27, 48, 3)
        assert np.abs(first.picture[12:, 12:].astype(int) - RED[12:, 12:]).max() < 12, "red is the first channel"


def test_a_stalled_camera_gives_nothing_and_comes_back(showing):
    shown = showing(RED)
    with open_camera(shown.stream.url) as camera:
        shown.stream.freeze("still")
        number, shot = 0, camera.wait(0, 5.0)
        while shot is not None:  # what was on its way
            number, taken = shot.number, shot.taken
            shot = camera.wait(number, 0.3)
        assert camera.wait(number, 0.1) is None
        assert camera.wait(number - 1, 0.0).taken == taken, "asked for again, an old picture keeps its age"
        shown.stream.resume()
        back = camera.wait(number, 5.0)
        assert back.number == number + 1 and back.taken > taken


def test_an_unplugged_stream_raises_with_its_name(showing):
    shown = showing(RED)
    with open_camera(shown.stream.url) as camera:
        shown.stream.unplug()
        with pytest.raises(CameraError, match=rf"^{shown.stream.url}: the camera has ended; connect it again"):
            number = 0
            while True:
                number = camera.wait(number, 5.0).number


def test_a_video_plays_at_its_own_rate_and_ends(tmp_path):
    path = video(tmp_path / "grey.avi", range(0, 200, 10))
    seen = []
    with open_camera(path) as camera, pytest.raises(CameraError, match=r"grey\.avi: the video has ended"):
        while True:
            seen.append(camera.wait(seen[-1].number if seen else 0, 5.0))
    levels = [int(shot.picture.mean()) for shot in seen]
    assert [round(level, -1) for level in levels] == [10 * (shot.number - 1) for shot in seen]
    # 20 pictures at 50 a second: the last one is due after 0.38 s, however fast they are read
    assert seen[-1].number == 20 and seen[-1].taken - seen[0].taken >= 0.35
    assert all(shot.taken - seen[0].taken >= (shot.number - 1) / 50 - 0.025 for shot in seen)


def test_only_the_newest_picture_is_kept(tmp_path):
    path = video(tmp_path / "grey.avi", range(0, 200, 10))
    with open_camera(path) as camera:
        time.sleep(0.6)
        assert camera.wait(0, 0.0).number == 20


def raw_server(
    *pieces: bytes, answer=b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=b\r\n\r\n"
):
    """Answers one request with bytes as they are, and then holds the line until the client goes."""
    server = socket.create_server(("127.0.0.1", 0))

    def serve():
        with server, server.accept()[0] as client:
            client.recv(4096)
            with contextlib.suppress(ConnectionError):  # the client may go at any time
                for piece in (answer, *pieces):
                    client.sendall(piece)
                    time.sleep(0.02)
                while client.recv(4096):
                    pass

    threading.Thread(target=serve).start()
    return f"http://127.0.0.1:{server.getsockname()[1]}/"


def jpeg(level):
    return cv2.imencode(".jpg", np.full((16, 16, 3), level, np.uint8))[1].tobytes()


HEAD = b"--b\r\nContent-Type: image/jpeg\r\n\r\n"


def test_without_a_length_the_last_picture_does_not_wait_for_the_next():
    url = raw_server(HEAD + jpeg(10) + b"\r\n", HEAD + jpeg(200)[:100], jpeg(200)[100:])
    with open_camera(url) as camera:
        shot = camera.wait(1, 5.0)
        assert shot.number == 2 and abs(float(shot.picture.mean()) - 200) < 3


def test_pictures_in_chunks_are_put_together():
    data = HEAD + jpeg(90)
    chunks = b"".join(b"%x\r\n%s\r\n" % (len(part), part) for part in (data[:150], data[150:]))
    answer = (
        b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=b\r\nTransfer-Encoding: chunked\r\n\r\n"
    )
    with open_camera(raw_server(chunks, answer=answer)) as camera:
        assert abs(float(camera.wait(0, 5.0).picture.mean()) - 90) < 3


def opening_takes(source):
    start = time.monotonic()
    with pytest.raises(CameraError) as caught:
        open_camera(source)
    assert "\n" not in str(caught.value)
    return time.monotonic() - start, str(caught.value)


@pytest.mark.parametrize(
    "source, sentence",
    [
        ("97", "97: there is no device /dev/video97; connect the camera"),
        ("/dev/video97", "/dev/video97: no such video file or device"),
        ("no/such.avi", "no/such.avi: no such video file or device"),
        ("/dev/null", "/dev/null: cannot be opened"),
        ("http://127.0.0.1:1/", "http://127.0.0.1:1/: cannot be opened (Connection refused)"),
        ("http://", "http://: cannot be opened"),
        ("rtsp://127.0.0.1:1/", "rtsp://127.0.0.1:1/: cannot be opened"),
    ],
)
def test_what_is_not_there_is_said_at_once(source, sentence):
    took, said = opening_takes(source)
    assert said.startswith(sentence) and took < 4


@pytest.mark.parametrize("content", [b"", b"hello" * 1000, b"RIFF\x00\x00\x00\x00AVI LIST"])
def test_files_that_are_no_video(tmp_path, content):
    (tmp_path / "x.avi").write_bytes(content)
    took, said = opening_takes(str(tmp_path / "x.avi"))
    assert said.endswith("x.avi: is no video that can be read; give a video file") and took < 4


def test_pages_that_are_no_stream():
    answer = b"HTTP/1.1 404 Not Found\r\nContent-Type: text/html\r\n\r\n"
    assert "answers 404 Not Found with text/html, not an MJPEG stream" in opening_takes(raw_server(answer=answer))[1]


@pytest.mark.parametrize("answer", [b"", b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace\r\n\r\n--b"])
def test_servers_that_connect_and_then_say_nothing(answer, monkeypatch):
    assert camera_source.OPENING == 2.0
    monkeypatch.setattr(camera_source, "OPENING", 0.3)
    took, said = opening_takes(raw_server(answer=answer))
    assert ("gives no picture within 0.3 s" in said or "cannot be opened (timed out)" in said) and took < 4


@pytest.mark.parametrize("login", ["me:sec/ret@", "me:sec@ret@", "me:secret@"])
def test_no_part_of_a_password_is_shown(login):
    said = opening_takes(f"http://{login}127.0.0.1:1/x?pwd=secret")[1]
    assert "127.0.0.1:1/x: " in said and "sec" not in said and "ret" not in said.partition(": ")[0]


def test_passwords_stay_out_of_messages():
    assert opening_takes("http://me:secret@127.0.0.1:1/x")[1].startswith("http://127.0.0.1:1/x: cannot be opened")


def test_a_fault_of_the_reader_is_not_taken_for_a_stall():
    def broken():
        yield RED, time.monotonic()
        raise ZeroDivisionError("oh")

    camera = CameraSource("cam", broken(), lambda: None)
    assert camera.wait(0, 5.0).number == 1
    with pytest.raises(CameraError, match=r"^cam: cannot be read any more \(ZeroDivisionError: oh\)"):
        camera.wait(1, 5.0)


def test_repeated_pictures_are_new_arrivals_with_the_same_bytes(showing):
    # the guard tells them apart from a living camera by their checksum
    shown = showing(RED)
    with open_camera(shown.stream.url) as camera:
        shown.stream.freeze("repeat")
        time.sleep(0.2)
        first = camera.wait(camera.wait(0, 5.0).number, 5.0)
        second = camera.wait(first.number, 5.0)
        assert second.taken > first.taken and np.array_equal(first.picture, second.picture)


def test_closing_wakes_a_reader_that_waits():
    with PictureStream() as stream:
        ended = []

        def show():
            while not ended:
                stream.show(RED)
                time.sleep(0.01)

        shower = threading.Thread(target=show)
        shower.start()
        camera = open_camera(stream.url)
        ended.append(True)
        shower.join()
        start = time.monotonic()
        camera.close()
        assert time.monotonic() - start < 0.9, "it would have waited for CLOSING"
