"""What the header of a report says: which run, which machine, which versions."""

import os
import platform
import subprocess
from datetime import datetime
from importlib.metadata import version
from pathlib import Path

import torch

from carff.config import CarffConfig
from carff.report import RunInfo

LIBRARIES = ("torch", "numpy", "scikit-learn")
HERE = Path(__file__).resolve().parent


def describe_run(config: CarffConfig, scenario: str, command: str) -> RunInfo:
    """Returns the header of a report written now, on this machine."""
    libraries = [f"{name} {version(name)}" for name in LIBRARIES]
    return RunInfo(
        name=config.name,
        preset=config.evaluation.preset,
        scenario=scenario,
        command=command,
        machine=machine(),
        date=datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z"),
        commit=commit(),
        seed=config.seed,
        versions=", ".join([f"Python {platform.python_version()}", *libraries]),
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
