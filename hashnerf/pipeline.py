"""Runs the scripts of a pipeline, each in a process of its own, and notes time and memory.

A process per stage keeps one stage's memory out of the next one's figures, and a stage that is interrupted is continued
by running the same command again: finished stages say so and end at once. Stages that do not need each other run side
by side as the members of a *phase*: the phase counts with its wall-clock time, its members are details of it that no
total adds up.

`timings.json` in the run folder: {"stages": {name: {"seconds", "peak_memory_mb", "processor_seconds", "within" (members
only): phase}}}. Processor seconds, those of all threads, are what other work on the machine hardly changes.
"""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from hashnerf.command_line import usable_cores
from hashnerf.errors import UserError
from hashnerf.transforms_json import read_transforms, write_atomically

TIMINGS = "timings.json"
LOGS = "logs"
PATIENCE = 30.0
"""Seconds that a stage gets to save and end once it was told to stop."""
TAIL = 30
"""Lines of a failed stage's output that are shown."""
PAUSE = 0.05
"""Seconds between two looks at stages that run side by side."""


def read_timings(folder: Path) -> dict[str, dict]:
    """Returns what earlier calls noted: stage name -> {seconds, peak_memory_mb}, members of a phase with its name."""
    path = folder / TIMINGS
    return read_transforms(path)["stages"] if path.is_file() else {}


def total_seconds(stages: Mapping[str, Mapping]) -> float:
    """Returns the wall-clock time of all stages; what ran side by side within a phase is in the phase's time."""
    return float(sum(stage["seconds"] for stage in stages.values() if "within" not in stage))


def run_stage(name: str, command: Sequence[str], folder: Path, quiet: bool = False) -> None:
    """Runs one script and adds its time and peak memory to the run's timings; a failing script ends this one alike.

    What a `quiet` stage prints goes to its log (`log_of`).
    """
    if quiet:
        log = log_of(folder, name)
        log.parent.mkdir(parents=True, exist_ok=True)
        with log.open("wb") as file:
            _run_to_its_end(name, command, folder, stdout=file, stderr=subprocess.STDOUT)
        return
    print(f"\n== {name}", flush=True)
    _run_to_its_end(name, command, folder)


def log_of(folder: Path, stage: str) -> Path:
    """Where the output of a stage goes that does not print to the terminal."""
    return folder / LOGS / f"{_log_name(stage)}.log"


def _run_to_its_end(name: str, command: Sequence[str], folder: Path, **streams: object) -> None:
    start = time.monotonic()
    process = subprocess.Popen([sys.executable, *command], **streams)
    try:
        _, status, usage = os.wait4(process.pid, 0)
    except KeyboardInterrupt:
        # The terminal has sent Ctrl-C to the stage as well; it saves and ends by itself.
        _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        _end_alike(process.returncode)
    seconds = time.monotonic() - start
    note(folder, name, seconds, _megabytes(usage), processor_seconds=usage.ru_utime + usage.ru_stime)


def run_stages_together(
    stages: Sequence[tuple[str, Sequence[str]]], folder: Path, workers: int, phase: str = ""
) -> None:
    """Runs scripts given as (name, command) side by side, `workers` at a time, as one phase of the run.

    They share the cores: each gets its part of the threads, unless its command asks for more.

    What a stage prints goes to `<folder>/logs/<name>.log`. The first that fails stops the others, the end of its
    output is shown, and this process ends with its status; so does Ctrl-C. The phase (by default named after its
    stages) is noted with its wall-clock time, every finished stage with its own. Raises UserError for two stages of
    one name.
    """
    names = [name for name, _ in stages]
    if len({_log_name(name) for name in names}) < len(names):
        raise UserError(f"stages {', '.join(names)}: give each a name of its own")
    phase = phase or " + ".join(names)
    print(f"\n== {phase}", flush=True)
    waiting, running = deque(stages), []
    with timed_phase(phase, folder), _ending_on_signals():
        try:
            while waiting or running:
                while waiting and len(running) < max(workers, 1):
                    running.append(_start(*waiting.popleft(), folder, usable_cores() // max(workers, 1) or 1))
                time.sleep(PAUSE)
                for stage in [stage for stage in running if stage.has_ended()]:
                    running.remove(stage)
                    _finish(stage, phase, folder)
        except BaseException:
            _stop(running)
            raise


@contextmanager
def timed_phase(name: str, folder: Path) -> Iterator[None]:
    """Notes the wall-clock time of what happens inside as the phase `name`, also when it ends early.

    Stages of the phase are noted with `within=name`. Its memory is that of its largest stage.
    """
    start = time.monotonic()
    try:
        yield
    finally:
        members = [stage for stage in read_timings(folder).values() if stage.get("within") == name]
        peak = max((stage["peak_memory_mb"] for stage in members), default=0.0)
        note(folder, name, time.monotonic() - start, peak)


def note(
    folder: Path,
    name: str,
    seconds: float,
    peak_memory_mb: float,
    within: str = "",
    processor_seconds: float | None = None,
) -> None:
    """Adds a stage's cost to the timings; one that was continued adds up. `within` names the phase it belongs to."""
    stages = read_timings(folder)
    earlier = stages.get(name, {"seconds": 0.0, "peak_memory_mb": 0.0})
    stages[name] = {
        "seconds": round(earlier["seconds"] + seconds, 2),
        "peak_memory_mb": round(max(earlier["peak_memory_mb"], peak_memory_mb), 1),
    }
    if processor_seconds is not None:
        stages[name]["processor_seconds"] = round(earlier.get("processor_seconds", 0.0) + processor_seconds, 2)
    if within:
        stages[name]["within"] = within
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / TIMINGS, json.dumps({"stages": stages}, indent=1).encode())


def check_script_folder(scripts: Path, *names: str) -> None:
    """Raises UserError where the named scripts are not."""
    if not all((scripts / name).is_file() for name in names):
        raise UserError(f"{scripts}: the scripts are not here; run from a checkout of the repository")


@dataclass
class _Running:
    """A stage that runs side by side with others."""

    name: str
    process: subprocess.Popen
    log: Path
    start: float
    usage: object = None

    def has_ended(self) -> bool:
        """Whether it has ended; its resource usage is known from then on."""
        if self.process.returncode is None:
            pid, status, usage = os.wait4(self.process.pid, os.WNOHANG)
            if pid:
                self.process.returncode = os.waitstatus_to_exitcode(status)
                self.usage = usage
        return self.process.returncode is not None


def _start(name: str, command: Sequence[str], folder: Path, threads: int) -> _Running:
    log = log_of(folder, name)
    log.parent.mkdir(parents=True, exist_ok=True)
    print(f"   {name}: started, writes to {log}", flush=True)
    with log.open("wb") as file:
        process = subprocess.Popen(
            [sys.executable, *command],
            stdin=subprocess.DEVNULL,
            stdout=file,
            env=os.environ | {"OMP_NUM_THREADS": str(threads)},  # threads of several that share a core wait in turns
            stderr=subprocess.STDOUT,
            process_group=0,  # the terminal's Ctrl-C comes here alone and is passed on once: a second one kills
        )
    return _Running(name, process, log, time.monotonic())


def _finish(stage: _Running, phase: str, folder: Path) -> None:
    seconds = time.monotonic() - stage.start
    if stage.process.returncode != 0:
        print(f"   {stage.name}: failed after {seconds:.0f} s; the end of {stage.log}:", flush=True)
        for line in stage.log.read_text(encoding="utf-8", errors="replace").splitlines()[-TAIL:]:
            print(f"   {stage.name} | {line}", flush=True)
        _end_alike(stage.process.returncode)
    print(f"   {stage.name}: done in {seconds:.0f} s", flush=True)
    used = stage.usage.ru_utime + stage.usage.ru_stime
    note(folder, stage.name, seconds, _megabytes(stage.usage), phase, used)


def _stop(running: Sequence[_Running]) -> None:
    """Ends stages as Ctrl-C does, so that they save; what has not ended in time, or at a second Ctrl-C, is killed."""
    for stage in running:
        if not stage.has_ended():
            print(f"   {stage.name}: is stopped", flush=True)
            stage.process.send_signal(signal.SIGINT)
    deadline = time.monotonic() + PATIENCE
    try:
        while any([not stage.has_ended() for stage in running]) and time.monotonic() < deadline:
            time.sleep(PAUSE)
    finally:
        for stage in running:
            if not stage.has_ended():
                os.killpg(stage.process.pid, signal.SIGKILL)
                stage.process.wait()


@contextmanager
def _ending_on_signals() -> Iterator[None]:
    """Turns a closed terminal and a polite kill into an exit, so that no stage outlives this process."""

    def end(number: int, frame: object) -> NoReturn:
        raise SystemExit(128 + number)

    if threading.current_thread() is not threading.main_thread():  # Python allows signal handlers nowhere else
        yield
        return
    before = {number: signal.signal(number, end) for number in (signal.SIGTERM, signal.SIGHUP)}
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        # a job in the background ignores Ctrl-C; its stages must not inherit that, it is how they are told to stop
        before[signal.SIGINT] = signal.signal(signal.SIGINT, lambda number, frame: None)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _log_name(name: str) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in name)


def _end_alike(returncode: int) -> NoReturn:
    raise SystemExit(returncode if returncode > 0 else 128 - returncode)


def _megabytes(usage: object) -> float:
    return usage.ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)
