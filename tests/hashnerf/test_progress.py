"""Progress: plain lines where nobody can see a bar, a bar on a terminal, and never an error."""

import io
import sys
import time

import pytest

from hashnerf.progress import StepProgress, say


@pytest.fixture
def clock(monkeypatch):
    """A clock that the test moves by hand."""
    now = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_plain_lines_every_few_seconds_with_eta(monkeypatch, clock):
    out = io.StringIO()
    monkeypatch.setattr(sys, "stderr", out)
    shown = StepProgress("nerf", 100, 1000)
    shown.values = "loss 0.5"
    for step in range(101, 111):
        clock[0] += 1.0
        shown.show(step)
    # 5 steps in 5 s: one second a step, 895 left = 14 min 55 s; then 890 left.
    assert out.getvalue().splitlines() == [
        "nerf: 105/1000 steps, ETA 0:14:55, loss 0.5",
        "nerf: 110/1000 steps, ETA 0:14:50, loss 0.5",
    ]
    shown.show(1000)
    assert out.getvalue().splitlines()[-1] == "nerf: 1000/1000 steps, ETA 0:00:00, loss 0.5"
    shown.close()


def test_no_eta_before_the_first_step(monkeypatch, clock):
    out = io.StringIO()
    monkeypatch.setattr(sys, "stderr", out)
    shown = StepProgress("nerf", 0, 10)
    clock[0] += 6
    shown.show(0)
    assert out.getvalue() == "nerf: 0/10 steps, ETA unknown\n"


@pytest.mark.parametrize("encoding", ["utf-8", "ascii", "latin-1"])
def test_a_bar_on_a_terminal_of_any_encoding(monkeypatch, encoding):
    raw = io.BytesIO()
    terminal = io.TextIOWrapper(raw, encoding=encoding, write_through=True)
    terminal.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    shown = StepProgress("nerf", 0, 4)
    shown.values = "loss 0.5"
    shown.show(4)
    shown.close()
    text = raw.getvalue().decode(encoding)
    assert "4/4" in text
    assert "ETA" in text
    assert text.rindex("\x1b[?25h") > text.rindex("\x1b[?25l")  # the cursor is back


class Broken(io.StringIO):
    """A stream whose reader has gone or whose disk is full."""

    def __init__(self, error: Exception):
        super().__init__()
        self.error = error
        self.attempts = 0

    def write(self, text: str) -> int:
        self.attempts += 1
        raise self.error


@pytest.mark.parametrize(
    "error", [OSError(28, "No space left on device"), BrokenPipeError(), ValueError("closed file")]
)
def test_a_stream_that_cannot_be_written_is_no_reason_to_stop(monkeypatch, clock, error):
    stream = Broken(error)
    monkeypatch.setattr(sys, "stderr", stream)
    say("x")
    assert stream.attempts == 1
    shown = StepProgress("nerf", 0, 10)
    clock[0] += 6
    shown.show(10)
    shown.close()
    assert stream.attempts > 1
