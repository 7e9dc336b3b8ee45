"""Children that end, are ended, or do not end; and what is asked of the system, which is recorded and not done."""

import gc
import os
import signal
import subprocess
import sys
import time

import pytest

from aerial2ground.guard import priority
from aerial2ground.guard.priority import die_with_parent, end_child, prefer


def child(*words: str) -> int:
    """Starts a program; returns its number."""
    return os.posix_spawnp(words[0], words, os.environ)


def test_no_child():
    assert end_child(-1, 5.0) == 0


@pytest.mark.parametrize("code", [0, 3])
def test_a_child_that_ends_by_itself_is_waited_for(code):
    begun = time.monotonic()
    assert end_child(child("sh", "-c", f"exit {code}"), 30.0) == code
    assert time.monotonic() - begun < 25


def test_a_child_that_does_not_end_is_killed():
    begun = time.monotonic()
    number = child("sleep", "60")
    assert end_child(number, 0.05) == -signal.SIGKILL
    assert 0.05 <= time.monotonic() - begun < 50
    with pytest.raises(ChildProcessError):
        os.waitpid(number, os.WNOHANG)


def test_a_child_is_killed_once(monkeypatch):
    killed, kill = [], os.kill
    waits = iter([(0, 0), (0, 0), (0, 0), (7, 0)])
    monkeypatch.setattr(priority.os, "waitpid", lambda *_: next(waits))
    monkeypatch.setattr(priority.os, "kill", lambda *what: killed.append(what))
    assert end_child(7, 0.0) == 0
    assert killed == [(7, signal.SIGKILL)]
    assert kill is not priority.os.kill


def test_a_child_that_ends_in_time_is_not_killed(monkeypatch):
    killed = []
    waits = iter([(0, 0), (0, 0), (7, 256)])
    monkeypatch.setattr(priority.os, "waitpid", lambda *_: next(waits))
    monkeypatch.setattr(priority.os, "kill", lambda *what: killed.append(what))
    assert end_child(7, 1000.0) == 1
    assert killed == []


@pytest.fixture
def system(monkeypatch):
    """Records what the system is asked for."""
    asked = []

    class Library:
        def __getattr__(self, name):
            return lambda *arguments: asked.append((name, *arguments))

    monkeypatch.setattr(priority.os, "setpriority", lambda *what: asked.append(("setpriority", *what)))
    monkeypatch.setattr(
        priority.os, "sched_setscheduler", lambda number, how, what: asked.append((number, how, what.sched_priority))
    )
    monkeypatch.setattr(priority.ctypes, "CDLL", lambda name: Library())
    monkeypatch.setattr(priority.gc, "freeze", lambda: asked.append("freeze"))
    return asked


def test_r30_the_guard_goes_first(system, bridge_row):
    assert prefer()
    wanted = [("setpriority", os.PRIO_PROCESS, 0, -15), (0, os.SCHED_FIFO, 1), ("mlockall", 1), "freeze"]
    bridge_row("R30", "precautions that are not asked for", sum(one not in system for one in wanted), 0)
    assert system == wanted


@pytest.mark.parametrize("name", ["setpriority", "sched_setscheduler"])
def test_a_system_that_allows_none_of_it(system, monkeypatch, name):
    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(priority.os, name, refuse)
    assert prefer() is (name == "setpriority")
    assert system[-2:] == [("mlockall", 1), "freeze"] and len(system) == 3


def test_the_end_of_the_parent_is_a_signal(system):
    die_with_parent(signal.SIGHUP)
    assert system == [("prctl", 1, 1)]


def test_r13_a_child_hears_of_its_parents_end(bridge_row):
    """A grandchild asks for the signal, its parent ends, and the grandchild tells us."""
    grandchild = (
        "import os, signal, sys, time\n"
        "from aerial2ground.guard.priority import die_with_parent\n"
        "reader, writer = os.pipe()\n"
        "if os.fork() == 0:\n"
        "    signal.signal(signal.SIGHUP, lambda *_: (os.write(1, b'heard'), os._exit(0)))\n"
        "    die_with_parent(signal.SIGHUP)\n"
        "    os.write(writer, b'.')\n"
        "    time.sleep(60)\n"
        "os.read(reader, 1)\n"
    )
    said = subprocess.run([sys.executable, "-c", grandchild], stdout=subprocess.PIPE, timeout=100, check=True).stdout
    bridge_row("R13", "ends of the parent that are not heard of", said != b"heard", 0)


def test_it_is_really_done_in_a_process_of_its_own():
    code = "import gc; from aerial2ground.guard.priority import prefer; prefer(); print(gc.get_freeze_count() > 0)"
    said = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, timeout=100, check=True, text=True)
    assert said.stdout == "True\n"
    assert gc.isenabled()


def test_a_child_that_the_system_has_forgotten():
    """Whoever started us may have children forgotten: then there is nobody to wait for."""
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        child = os.posix_spawnp("sh", ["sh", "-c", "exit 3"], os.environ)
        assert end_child(child, 100.0) == 0
    finally:
        signal.signal(signal.SIGCHLD, before)
