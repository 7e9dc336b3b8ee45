"""Memory that was freed is there for the next step."""

import platform
import subprocess
import sys

from hashnerf import heap

PAGES_TOUCHED = """
import resource
import sys
import numpy as np
from hashnerf.heap import keep_freed_memory

if sys.argv[1] == "kept":
    assert keep_freed_memory()

def step():
    # two blocks, so that the allocator cannot learn from the first one's size
    return np.ones(50_000_000), np.ones(6_000_000)

step()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
step()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def test_a_second_step_asks_the_system_for_no_more_pages():
    if platform.libc_ver()[0] != "glibc":  # the setting is the GNU C library's
        assert not heap.keep_freed_memory()
        return

    def pages(way):
        command = [sys.executable, "-c", PAGES_TOUCHED, way]
        return int(subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout)

    assert pages("kept") < 100
    assert pages("plain") > 200, "else this test shows nothing"


def test_other_c_libraries_are_left_alone(monkeypatch):
    monkeypatch.setattr(heap.ctypes, "CDLL", lambda name: object())
    assert not heap.keep_freed_memory()
