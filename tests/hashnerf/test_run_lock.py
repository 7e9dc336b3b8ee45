"""The lock of a run folder: one holder, freed by any death, careful with other hosts."""

import json
import os
import socket

import pytest

from hashnerf.errors import UserError
from hashnerf.run_lock import RunLock


def test_k09_one_holder_at_a_time(tmp_path, numeric_row):
    first, second = RunLock(tmp_path), RunLock(tmp_path)
    first.acquire()
    assert json.loads((tmp_path / ".lock").read_text()) == {"pid": os.getpid(), "host": socket.gethostname()}
    with pytest.raises(UserError, match=f"in use by process {os.getpid()} on {socket.gethostname()}"):
        second.acquire()
    first.release()
    second.acquire()
    second.release()
    second.release()
    numeric_row(
        "K09", "two locks of one folder: not refused, or not given back", (tmp_path / ".lock").stat().st_size > 0
    )


def test_k09_a_process_that_died_leaves_no_lock(tmp_path, numeric_row):
    child = os.fork()
    if child == 0:
        RunLock(tmp_path).acquire()
        os._exit(0)  # as after kill -9: nothing is released by hand
    os.waitpid(child, 0)
    assert json.loads((tmp_path / ".lock").read_text())["pid"] == child
    lock = RunLock(tmp_path)
    lock.acquire()
    stale = json.loads((tmp_path / ".lock").read_text())["pid"] != os.getpid()
    lock.release()
    numeric_row("K09", "a holder that died without releasing: still in the way", stale)


def test_k09_another_host_that_did_not_end_cleanly_is_respected(tmp_path, numeric_row):
    (tmp_path / ".lock").write_text(json.dumps({"pid": 7, "host": "elsewhere"}))
    lock = RunLock(tmp_path)
    with pytest.raises(UserError, match=r"process 7 on elsewhere.*delete .*\.lock"):
        lock.acquire()
    (tmp_path / ".lock").unlink()
    lock.acquire()
    stale = json.loads((tmp_path / ".lock").read_text())["pid"] != os.getpid()
    lock.release()
    numeric_row("K09", "another host's lock, refused and then deleted by hand: still in the way", stale)


@pytest.mark.parametrize("text", ["", "{", "[1]", "\x00"])
def test_a_garbled_lock_file_is_no_obstacle(tmp_path, text):
    (tmp_path / ".lock").write_text(text)
    lock = RunLock(tmp_path)
    lock.acquire()
    assert json.loads((tmp_path / ".lock").read_text())["pid"] == os.getpid()
    lock.release()
