"""What the header of a report says: which run, which machine, which versions."""

import os
import platform
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from importlib.metadata import version
from pathlib import Path

import torch

LIBRARIES = ("torch", "numpy", "scikit-learn")
HERE = Path(__file__).resolve().parent


@dataclass(frozen=True)
class RunInfo:
    """What the header of a report says about the run."""

    name: str
    preset: str
    scenario: str
    command: str
    machine: str
    date: str
    commit: str
    seed: int
    versions: str
    """Interpreter and main libraries, such as `Python 3.11, torch 2.13`."""


def run_info_now(
    name: str, preset: str, scenario: str, command: str, seed: int, libraries: Sequence[str] = LIBRARIES
) -> RunInfo:
    """Returns the header of a report written now, on this machine."""
    return RunInfo(
        name=name,
        preset=preset,
        scenario=scenario,
        command=command,
        machine=machine(),
        date=datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z"),
        commit=commit(),
        seed=seed,
        versions=", ".join(
            [f"Python {platform.python_version()}", *(f"{library} {version(library)}" for library in libraries)]
        ),
    )


def machine() -> str:
    """Processor, cores this process may use, memory, and the GPU if there is one."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    parts = [
        processor(Path("/proc/cpuinfo")),
        f"{cores} cores, {torch.get_num_threads()} threads used",
        f"{memory:.0f} GiB",
    ]
    if torch.cuda.is_available():
        parts.append(torch.cuda.get_device_name())
    return ", ".join(parts)


def processor(cpuinfo: Path) -> str:
    """The processor's name as Linux states it, otherwise as Python knows it."""
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def commit(folder: Path = HERE) -> str:
    """The checked-out commit, marked where files differ from it; `unknown` outside a git checkout."""
    try:
        head = _git(folder, "rev-parse", "--short=12", "HEAD")
        changed = _git(folder, "status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{head} with changes" if changed else head


def _git(folder: Path, *arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.strip()
