"""The black box, on disks that are full, slow, or not there."""

import errno
import inspect
import json
import os
import statistics
import threading
import time

import pytest

from aerial2ground.guard import black_box
from aerial2ground.guard.black_box import CAP, QUEUE, SLOT, SLOTS, BlackBox
from hashnerf.errors import UserError

DISK = {name: getattr(os, name) for name in ("pwrite", "posix_fallocate")}


@pytest.fixture
def boxes():
    """Boxes that are closed at the end."""
    made = []
    yield made
    for box in made:
        box.close(10.0)
        assert not box._thread.is_alive()


def ring(folder) -> list[dict]:
    """The records of the ring, in the order of their places."""
    data = (folder / "last_minute.jsonl").read_bytes()
    slots = [data[place : place + SLOT] for place in range(0, len(data), SLOT)]
    return [json.loads(slot) for slot in slots if slot.strip(b"\0")]


def lines(folder) -> list[dict]:
    """The records of the log."""
    return [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]


def test_what_is_added_is_in_both_files(tmp_path):
    folder = tmp_path / "a" / "b"
    box = BlackBox(folder)
    records = [{"t": 0.1 * step, "in": [], "fault": None} for step in range(50)]
    for record in records:
        box.add(record)
    box.close(10.0)
    assert lines(folder) == ring(folder) == records
    assert box.lost == 0
    assert (folder / "log.jsonl").read_text().splitlines()[1] == '{"t":0.1,"in":[],"fault":null}'


def test_the_ring_takes_its_place_before_the_drive(tmp_path, boxes):
    boxes.append(BlackBox(tmp_path))
    file = os.stat(tmp_path / "last_minute.jsonl")
    assert file.st_size == SLOTS * SLOT == 3000 * 1024
    assert file.st_blocks * 512 >= file.st_size
    assert not (tmp_path / "log.jsonl").exists()
    assert (CAP, QUEUE) == (100_000_000, 3000)
    assert boxes[0]._thread.daemon


def test_the_ring_goes_round(tmp_path, monkeypatch):
    monkeypatch.setattr(black_box, "SLOTS", 5)
    box = BlackBox(tmp_path)
    for step in range(13):
        box.add({"t": step})
    box.close(10.0)
    assert [one["t"] for one in ring(tmp_path)] == [10, 11, 12, 8, 9]
    assert len(lines(tmp_path)) == 13
    assert (tmp_path / "last_minute.jsonl").stat().st_size == 5 * SLOT


def test_every_line_of_the_ring_has_the_same_length(tmp_path):
    box = BlackBox(tmp_path)
    fits = {"x": "y" * (SLOT - len('{"x":""}') - 1)}
    too_long = {"x": fits["x"] + "y"}
    flooded = {"t": 2, "in": [[0, "word", "held"]] * 100, "out": "02"}
    for record in (fits, too_long, flooded):
        box.add(record)
    box.close(10.0)
    assert ring(tmp_path) == [fits, {"in": "cut"}, {"t": 2, "in": "cut", "out": "02"}]
    assert lines(tmp_path) == [fits, too_long, flooded]
    data = (tmp_path / "last_minute.jsonl").read_bytes()
    assert [place for place, code in enumerate(data) if code == 10] == [1023, 2047, 3071]


def test_an_old_log_is_kept_and_an_old_ring_is_not(tmp_path):
    for step in range(2):
        box = BlackBox(tmp_path)
        box.add({"run": step})
        box.close(10.0)
    assert lines(tmp_path) == [{"run": 0}, {"run": 1}]
    assert ring(tmp_path) == [{"run": 1}]


def test_r28_the_log_has_an_end_and_the_ring_goes_on(tmp_path, bridge_row):
    box = BlackBox(tmp_path, cap=40)
    for step in range(20):
        box.add({"t": step + 10})  # nine bytes and the end of the line
    box.close(10.0)
    assert lines(tmp_path) == [{"t": 10}, {"t": 11}, {"t": 12}, {"t": 13}]
    assert box.lost == 16
    assert [one["t"] for one in ring(tmp_path)] == list(range(10, 30))
    bridge_row("R28", "bytes of a log that may have 40", (tmp_path / "log.jsonl").stat().st_size, 40, "bytes")


@pytest.mark.parametrize("kind", ["full", "fifo nobody reads", "fifo read slowly"])
def test_r28_disks_that_take_nothing(tmp_path, kind, bridge_row):
    reader = None
    if kind == "full":
        (tmp_path / "log.jsonl").symlink_to("/dev/full")
    else:
        os.mkfifo(tmp_path / "log.jsonl")
        if kind == "fifo read slowly":
            reader = os.open(tmp_path / "log.jsonl", os.O_RDONLY | os.O_NONBLOCK)
    box = BlackBox(tmp_path)
    text, spent = "x" * 500, []
    for step in range(400):
        begun = time.perf_counter()
        box.add({"t": step, "x": text})
        spent.append(time.perf_counter() - begun)
    box.close(30.0)
    assert not box._thread.is_alive()
    if reader is not None:
        os.close(reader)
        assert 200 < box.lost < 300  # 65536 bytes of 518 each fit in
    else:
        assert box.lost == 400
    missing = set(range(400)) - {one["t"] for one in ring(tmp_path)}
    bridge_row("R28", f"log on: {kind}; lines of the last minute that are missing", len(missing), 0)
    bridge_row("R28", f"log on: {kind}; median of what a cycle waits", 1000 * statistics.median(spent), 1.0, "ms")


def test_r28_a_disk_that_hangs_holds_up_nobody(tmp_path, monkeypatch, bridge_row):
    begun, goes_on = threading.Event(), threading.Event()

    def hangs(*arguments):
        begun.set()
        assert goes_on.wait(60)
        return DISK["pwrite"](*arguments)

    monkeypatch.setattr(black_box.os, "pwrite", hangs)
    box = BlackBox(tmp_path)
    box.add({"t": 0})
    assert begun.wait(60)
    for step in range(QUEUE):
        box.add({"t": step})
    assert box.lost == 0
    for _ in range(10):
        box.add({"t": -1})
    box.close(0.01)  # is left behind
    assert box._thread.is_alive()
    goes_on.set()
    box.close(60.0)
    assert not box._thread.is_alive()
    assert len(lines(tmp_path)) == QUEUE + 1
    bridge_row("R28", "lines lost without being counted, of 3011 on a disk that hangs", 10 - box.lost, 0)


def test_a_disk_that_fails_for_a_while(tmp_path, monkeypatch):
    failures = iter([False, True, True, False])

    def fails(*arguments):
        if next(failures):
            raise OSError(errno.EIO, "for a test")
        return DISK["pwrite"](*arguments)

    monkeypatch.setattr(black_box.os, "pwrite", fails)
    box = BlackBox(tmp_path)
    for step in range(4):
        box.add({"t": step})
    box.close(10.0)
    assert box.lost == 2
    assert [one["t"] for one in ring(tmp_path)] == [0, 3]


def test_close_waits_a_second_at_most_and_gives_the_files_back(tmp_path):
    box = BlackBox(tmp_path)
    box.add({"t": 0})
    box.close()
    box._thread.join(30)
    for descriptor in (box._ring, box._log):
        with pytest.raises(OSError):
            os.fstat(descriptor)
    assert inspect.signature(BlackBox.close).parameters["seconds"].default == 1.0


def test_a_box_without_lines_is_closed_too(tmp_path):
    box = BlackBox(tmp_path)
    box.close(10.0)
    assert not box._thread.is_alive() and not (tmp_path / "log.jsonl").exists()
    with pytest.raises(OSError):
        os.fstat(box._ring)


def test_a_folder_that_cannot_be(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match=r"file/log: the log has no place there .Not a directory.; give another"):
        BlackBox(tmp_path / "file" / "log")


def test_a_disk_without_room_is_found_out_before_the_drive(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(black_box.os, "posix_fallocate", full)
    with pytest.raises(UserError, match=r"no place there .No space left on device.; give another --log"):
        BlackBox(tmp_path)


def test_the_thread_sleeps_while_nothing_is_there(tmp_path, boxes):
    boxes.append(BlackBox(tmp_path))
    boxes[0].add({"t": 0})
    ends = time.monotonic() + 30
    while boxes[0]._there.is_set() and time.monotonic() < ends:
        time.sleep(0.005)
    assert not boxes[0]._there.is_set()
