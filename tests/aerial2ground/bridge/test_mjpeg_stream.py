"""JPEG pictures are found in a stream of bytes, whatever comes around and inside them."""

import cv2
import numpy as np
import pytest

from aerial2ground.bridge.mjpeg_stream import jpeg_end, newest_jpeg

NOISE = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)
ONE, TWO = (cv2.imencode(".jpg", picture)[1].tobytes() for picture in (NOISE, NOISE[::-1]))
PROGRESSIVE = cv2.imencode(".jpg", NOISE, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
PREVIEW = b"\xff\xe1" + (len(TWO) + 2).to_bytes(2, "big") + TWO
"""A whole JPEG inside a segment, as cameras put previews there."""


@pytest.mark.parametrize("picture", [ONE, ONE[:2] + PREVIEW + ONE[2:], ONE[:2] + b"\xff" + ONE[2:]])
def test_a_whole_picture_and_every_cut_of_it(picture):
    for cut in range(len(picture)):
        assert newest_jpeg(b"--b\r\n\r\n" + picture[:cut])[0] is None
    assert newest_jpeg(b"--b\r\n\r\n" + picture + b"\r\n--b") == (picture, newest_jpeg(b"\r\n--b")[1])
    assert jpeg_end(picture, 0) == len(picture)


def test_a_progressive_picture_ends_with_its_last_scan():
    assert PROGRESSIVE.count(b"\xff\xda") > 1 and jpeg_end(PROGRESSIVE, 0) == len(PROGRESSIVE)


def test_the_last_of_several_counts_and_what_follows_is_kept():
    assert newest_jpeg(ONE + b"--b\r\n" + TWO + b"--b\r\n" + ONE[:300]) == (TWO, ONE[:300])


def test_in_pieces_of_any_size_each_picture_comes_once():
    stream = b"".join(b"--b\r\n\r\n" + one + b"\r\n" for one in (ONE, TWO, ONE))
    for size in (1, 7, 100, 1000):
        found, buffer = [], b""
        for start in range(0, len(stream), size):
            newest, buffer = newest_jpeg(buffer + stream[start : start + size])
            found += [newest] if newest else []
        assert [one for one in found] == [ONE, TWO, ONE]


def test_what_only_looks_like_a_picture_is_passed_over():
    assert newest_jpeg(b"\xff\xd8\xff\xe0\x00\x02junk" + ONE) == (ONE, b"")
    assert newest_jpeg(bytes(1000)) == (None, bytes(2))
