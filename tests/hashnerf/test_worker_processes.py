"""Work in several processes gives what one gives, in order, with one thread each."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from hashnerf.errors import UserError
from hashnerf.worker_processes import map_in_processes


def squares():
    return lambda number: (number**2, os.getpid())


def threads():
    return lambda item: torch.get_num_threads()


def failing():
    def work(number: int) -> int:
        if number == 3:
            raise ValueError("number 3")
        return number

    return work


@pytest.mark.parametrize("workers, processes", [(1, 1), (2, 2)])
def test_results_come_in_order_from_as_many_processes(workers, processes):
    results = list(map_in_processes(squares, range(8), workers))
    assert [square for square, _ in results] == [number**2 for number in range(8)]
    assert len({pid for _, pid in results}) <= processes
    assert (os.getpid() in {pid for _, pid in results}) == (workers == 1)


def test_a_process_has_one_thread():
    assert list(map_in_processes(threads, range(2), 2)) == [1, 1]


def test_no_items_need_nothing():
    def never():
        raise AssertionError("made for nothing")

    assert list(map_in_processes(never, [], 2)) == []


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_comes_through(workers):
    with pytest.raises(ValueError, match="number 3"):
        list(map_in_processes(failing, range(8), workers))


def killed():
    def work(number: int) -> int:
        if number == 3:
            os.kill(os.getpid(), signal.SIGKILL)
        return number

    return work


def test_k25_a_killed_worker_is_told_and_waited_for_by_nobody(numeric_row):
    results = []
    with pytest.raises(UserError, match="a worker process was killed"):
        results.extend(map_in_processes(killed, range(64), 2))
    numeric_row("K25", "one of two workers killed: results of work that was not done", sum(n >= 3 for n in results))


def unprepared():
    raise UserError("runs/x: no field here; run scripts/train_road_nerf.py first")


@pytest.mark.parametrize("workers", [1, 2])
def test_what_is_missing_is_said_in_its_own_words(workers):
    with pytest.raises(UserError, match="no field here"):
        list(map_in_processes(unprepared, range(4), workers))


INTERRUPTED_AT_THE_START = """
import multiprocessing, os, signal, sys, threading, time
from tests.hashnerf.test_worker_processes import squares
from hashnerf.worker_processes import map_in_processes

def interrupt():
    while len(multiprocessing.active_children()) < 2:
        time.sleep(0.001)
    time.sleep(0.3)  # the children are importing now
    os.killpg(0, signal.SIGINT)  # as a terminal does: to every process of the group

if __name__ == "__main__":
    threading.Thread(target=interrupt, daemon=True).start()
    try:
        list(map_in_processes(squares, range(8), 2))
    except KeyboardInterrupt:
        sys.exit(130)
"""


def test_ctrl_c_while_the_processes_start_is_heard_here_alone(tmp_path):
    script = tmp_path / "interrupted.py"
    script.write_text(INTERRUPTED_AT_THE_START)
    ended = subprocess.run(
        [sys.executable, str(script)],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        start_new_session=True,
        timeout=90,
        # A test run started in the background ignores Ctrl-C and hands that down; a terminal does not.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert ended.stderr == ""
    assert ended.returncode == 130


KILLED = """
import os, signal, sys, threading, time
from tests.hashnerf.test_worker_processes import squares
from hashnerf.worker_processes import worker_processes

if __name__ == "__main__":
    with worker_processes(squares, 2) as mapped:
        print(*{pid for _, pid in mapped(range(64))}, flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
"""


def test_processes_of_a_killed_parent_end(tmp_path):
    script = tmp_path / "killed.py"
    script.write_text(KILLED)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    ended = subprocess.run([sys.executable, str(script)], env=environment, stdout=subprocess.PIPE, timeout=90)
    assert ended.returncode == -signal.SIGKILL
    left = [int(pid) for pid in ended.stdout.split()]
    for _ in range(100):
        left = [pid for pid in left if Path(f"/proc/{pid}").exists()]
        if not left:
            return
        time.sleep(0.1)
    raise AssertionError(f"{left} still run")
