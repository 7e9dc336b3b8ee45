"""Mutation testing: runs a package's tests once for every mutant of its files and counts the mutants they notice.

Importing the tests' libraries takes far longer than the tests, so each worker process imports them once and forks for
every mutant (`mutation_worker`). A module's own tests, `test_<module>*.py`, run first, then all others. No type checker
of annotations is at work: the tests themselves must notice.
"""

import collections
import json
import os
import queue
import random
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hashnerf.errors import UserError
from hashnerf.mutants import Mutant, mutants_of
from hashnerf.mutation_worker import ERROR, KILLED, MODULE, ORIGINAL, SURVIVED, TIMED_OUT

START = "from hashnerf.mutation_worker import work; work()"


@dataclass(frozen=True)
class Tried:
    """A mutant and what became of it."""

    file: str
    """From the root of the repository."""
    line: int
    before: str
    after: str
    outcome: str
    """`killed`: a test failed; `timed out`; `survived`: all passed; `error`: pytest could not run, or died."""


@dataclass(frozen=True)
class MutationResult:
    """What became of all mutants."""

    tried: tuple[Tried, ...]

    @property
    def counts(self) -> dict[str, int]:
        """Mutants of every outcome."""
        return {name: sum(one.outcome == name for one in self.tried) for name in (KILLED, TIMED_OUT, SURVIVED, ERROR)}

    @property
    def killed_share(self) -> float:
        """The share of mutants that were noticed, by a failing test or because the tests no longer end."""
        return 1 - len(self.survivors) / len(self.tried)

    @property
    def survivors(self) -> tuple[Tried, ...]:
        """Mutants that went unnoticed, and those that nothing can be said about."""
        return tuple(one for one in self.tried if one.outcome in (SURVIVED, ERROR))

    def as_json(self) -> dict[str, Any]:
        """Returns the counts, those of every file, and the survivors, ready for JSON."""
        files = {
            file: {"mutants": count, "survivors": sum(one.file == file for one in self.survivors)}
            for file, count in collections.Counter(one.file for one in self.tried).items()
        }
        about = {"mutants": len(self.tried), "killed_share": self.killed_share, "counts": self.counts}
        return about | {"files": files, "survivors": [asdict(one) for one in self.survivors]}


@dataclass(frozen=True)
class Limits:
    """How many processes, and how long the tests of one mutant may take."""

    workers: int = 1
    """Processes that try mutants at the same time."""
    factor: float = 4.0
    """Times the duration of the same tests without a mutant ..."""
    seconds: float = 5.0
    """... and so many seconds more."""


def plan_mutants(root: Path, files: Sequence[str], share: float = 1.0, seed: int = 0) -> list[tuple[str, Mutant]]:
    """Returns the mutants of files (relative to the root), or a random share of them, in the order of their lines.

    Raises UserError where there are none, or a file is no Python module.
    """
    mutants = []
    for file in files:
        try:
            mutants += [(file, mutant) for mutant in mutants_of((root / file).read_text(encoding="utf-8"))]
        except SyntaxError as error:
            raise UserError(f"{file}: is no Python module; mend it: {error}") from error
    if not mutants:
        raise UserError(f"{', '.join(files) or 'no file'}: has nothing to mutate; check the files")
    chosen = random.Random(seed).sample(range(len(mutants)), max(1, round(share * len(mutants))))
    return [mutants[index] for index in sorted(chosen)]


def run_mutants(
    root: Path, planned: Sequence[tuple[str, Mutant]], tests: str, limits: Limits | None = None
) -> Iterator[Tried]:
    """Yields what becomes of each mutant, in order; `tests` is a file or a folder below the root.

    Raises UserError where there are no tests, or they fail without any mutant.
    """
    limits = limits or Limits()
    place = root / tests
    found = [place] if place.is_file() else sorted(place.rglob("test_*.py"))
    if not found:
        raise UserError(f"{tests}: there are no test files; check the path")
    names = [path.relative_to(root).as_posix() for path in found]
    held = sorted({_module_name(file) for file, _ in planned})
    setup = {"tests": names, "held": held, "factor": limits.factor, "seconds": limits.seconds}
    jobs = [_job(root, file, mutant, names) for file, mutant in planned]
    for (file, mutant), outcome in zip(planned, _in_workers(root, setup, jobs, min(limits.workers, len(jobs)))):
        yield Tried(file, mutant.line, mutant.before, mutant.after, outcome)


def _module_name(file: str) -> str:
    return file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def _job(root: Path, file: str, mutant: Mutant, tests: Sequence[str]) -> dict[str, Any]:
    stem = Path(file).stem
    own = [name for name in tests if Path(name).stem == f"test_{stem}" or Path(name).stem.startswith(f"test_{stem}_")]
    parts = [part for part in (own, [name for name in tests if name not in own]) if part]
    about = {MODULE: _module_name(file), ORIGINAL: str((root / file).resolve())}
    return {"parts": parts, "source": mutant.source, "variables": about}


def _in_workers(root: Path, setup: dict[str, Any], jobs: Sequence[dict], count: int) -> Iterator[str]:
    """The outcomes of the jobs in order, from several workers."""
    pool = ThreadPoolExecutor(count)
    workers = [_Worker(root, setup) for _ in range(count)]
    idle: queue.SimpleQueue[_Worker] = queue.SimpleQueue()
    for worker in workers:
        idle.put(worker)

    def outcome(job: dict[str, Any]) -> str:
        worker = idle.get()
        try:
            return worker.ask(job)
        finally:
            idle.put(worker)

    try:
        yield from pool.map(outcome, jobs)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for worker in workers:
            worker.close()
        pool.shutdown()


class _Worker:
    """A worker process, seen from the process that asks: one JSON line each way per job."""

    def __init__(self, root: Path, setup: dict[str, Any]):
        path = os.pathsep.join([str(root.resolve()), str(Path(__file__).resolve().parents[1])])
        outside = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
        one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # threads do not survive a fork
        self.process = subprocess.Popen(
            [sys.executable, "-c", START],
            cwd=root,
            env=outside | one_thread | {"PYTHONPATH": path},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._say(setup)

    def _say(self, message: dict[str, Any]) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(message) + "\n")
        self.process.stdin.flush()

    def ask(self, job: dict[str, Any]) -> str:
        """Returns the outcome of a job; raises UserError where the tests fail without it or the process died."""
        try:
            self._say(job)
            line = self.process.stdout.readline() if self.process.stdout else ""
        except OSError:
            line = ""
        if not line:
            raise UserError("a process that runs mutants has ended: see its message, and start again")
        answer = json.loads(line)
        if "refused" in answer:
            raise UserError(answer["refused"])
        return answer["outcome"]

    def close(self) -> None:
        """Ends the process and what it runs."""
        self.process.terminate()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            try:
                pipe.close()
            except OSError:  # a job that was not taken
                continue
