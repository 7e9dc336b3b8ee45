"""The process that runs tests on mutants, and what puts a mutant in the place of its module.

The process imports all that the tests import, once, except the mutated files and what imports them; then it forks for
every mutant. Python programs that the tests start find the mutant by their environment variables and `sitecustomize`.
"""

import ast
import gc
import importlib
import importlib.machinery
import importlib.util
import json
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from hashnerf.errors import UserError

KILLED, TIMED_OUT, SURVIVED, ERROR = "killed", "timed out", "survived", "error"
MEMORY = 4 << 30
"""Bytes that a fork may allocate: an endless loop may fill the memory before its time is over."""
OPTIONS = ("-x", "-q", "--tb=no", "--import-mode=importlib", "-p", "no:cacheprovider", "-o", "addopts=")
PLACE = "from hashnerf.mutation_worker import place_mutant; place_mutant()"
MODULE, ORIGINAL, SOURCE = "MUTANT_MODULE", "MUTANT_ORIGINAL", "MUTANT_SOURCE"
"""Environment variables: a module's name, its file, and the file that holds its mutant."""


def work() -> None:
    """What a worker process does: reads the set-up, then one job a line, and answers each."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the asking process's to handle
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # by an exception, so that a running fork is ended
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what an import prints is no answer
    with tempfile.TemporaryDirectory() as folder:
        runner: _Runner | None = None
        setup = json.loads(sys.stdin.readline() or "{}")
        for line in sys.stdin:
            try:
                runner = runner or _Runner(Path(folder), setup)
                answer = {"outcome": runner.outcome(json.loads(line))}
            except UserError as error:
                answer = {"refused": str(error)}
            print(json.dumps(answer), file=answers, flush=True)


class _Runner:
    """Runs tests in forks of this process."""

    def __init__(self, folder: Path, setup: dict[str, Any]):
        self.folder, self.setup = folder, setup
        self.durations: dict[tuple[str | None, tuple[str, ...]], float] = {}
        (folder / "sitecustomize.py").write_text(PLACE + "\n", encoding="utf-8")
        os.environ["PYTHONPATH"] = str(folder) + os.pathsep + os.environ["PYTHONPATH"]
        self._fork(["--collect-only", *setup["tests"]], {})
        self._import_all_but(setup["held"])

    def _import_all_but(self, held: Sequence[str]) -> None:
        names = self.folder / "modules.json"
        holder = _Holder(held)
        sys.meta_path.insert(0, holder)
        for name in json.loads(names.read_text(encoding="utf-8")) if names.is_file() else []:
            try:
                importlib.import_module(name)
            except Exception:
                continue  # it imports what is held back, or is no module by itself: the tests import it
        sys.meta_path.remove(holder)
        mixed = sorted(set(held) & set(sys.modules))
        if mixed:
            raise UserError(f"{', '.join(mixed)}: is needed to run mutants and cannot be mutated itself; leave it out")
        gc.freeze()  # forks then share more memory

    def outcome(self, job: dict[str, Any]) -> str:
        """What becomes of a mutant; raises UserError where the same tests fail without it."""
        file = self.folder / "mutant.py"
        file.write_text(job["source"], encoding="utf-8")
        first, *others = (tuple(part) for part in job["parts"])
        # what is left after a module's own tests is not timed by itself: all tests take longer
        timed = [(first, self._time_unchanged(first, job["variables"]))]
        timed += [(part, self._time(tuple(self.setup["tests"]))) for part in others]
        for part, longest in timed:
            limit = self.setup["factor"] * longest + self.setup["seconds"]
            code = self._fork(part, job["variables"] | {SOURCE: str(file)}, limit)
            if code != 0:
                # 1: a test failed; 2 and 3: a test file could not be imported. All is well without the mutant
                return TIMED_OUT if code is None else KILLED if code in (1, 2, 3) else ERROR
        return SURVIVED

    def _time_unchanged(self, tests: tuple[str, ...], variables: dict[str, str]) -> float:
        """As `_time`, with the module put in its own place as a mutant would be, written anew from its syntax tree."""
        file = self.folder / "unchanged.py"
        original = Path(variables[ORIGINAL]).read_text(encoding="utf-8")
        file.write_text(ast.unparse(ast.parse(original)), encoding="utf-8")
        return self._time(tests, variables | {SOURCE: str(file)})

    def _time(self, tests: tuple[str, ...], variables: dict[str, str] | None = None) -> float:
        """Seconds that tests take without a mutant; raises UserError where they fail."""
        variables = variables or {}
        key = (variables.get(MODULE), tests)
        if key not in self.durations:
            begun = time.monotonic()
            code = self._fork(["-rfE", *tests], variables)
            if code != 0:
                said = (self.folder / "output.txt").read_text(encoding="utf-8", errors="replace")
                last = " ".join(said.split())[-300:]
                raise UserError(f"{', '.join(tests)}: fail without any mutant; mend them first: {last}")
            self.durations[key] = time.monotonic() - begun
        return self.durations[key]

    def _fork(self, arguments: Sequence[str], variables: dict[str, str], limit: float | None = None) -> int | None:
        """Runs pytest in a fork and returns its exit code, negative for a signal; None when it ran past the limit."""
        child = os.fork()
        if child == 0:
            self._in_child(arguments, variables, limit)
        end = time.monotonic() + (limit or float("inf"))
        ended = None
        try:
            while ended is None and time.monotonic() < end:
                ended = os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT)
                time.sleep(0.005)
        finally:
            # also what the tests have left behind; not yet waited for, so the number is still this child's
            for kill in (os.killpg, os.kill):
                try:
                    kill(child, signal.SIGKILL)
                except (ProcessLookupError, PermissionError):
                    continue
            code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        return code if ended is not None else None

    def _in_child(self, arguments: Sequence[str], variables: dict[str, str], limit: float | None) -> None:
        code = os.EX_SOFTWARE  # no code of pytest's
        try:
            os.setsid()
            signal.signal(signal.SIGINT, signal.default_int_handler)
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
            if limit is not None:
                seconds = int(limit) + 10  # should this worker be killed, an endless loop still ends
                resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
            output = self.folder / "output.txt" if limit is None else os.devnull
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            os.dup2(os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 1)
            os.dup2(1, 2)
            os.environ.update(variables)
            place_mutant()
            # forks end without clearing up, so they all share one folder for temporary files
            code = _run_pytest([f"--basetemp={self.folder / 'pytest'}", *arguments])
            if "--collect-only" in arguments:
                (self.folder / "modules.json").write_text(json.dumps(_modules_of_libraries()), encoding="utf-8")
            sys.stdout.flush()
        finally:
            os._exit(code)


def _run_pytest(arguments: Sequence[str]) -> int:
    import pytest  # only here: whatever the tests start finds its mutant in this module, and needs no pytest

    return int(pytest.main([*OPTIONS, f"--rootdir={os.getcwd()}", *arguments], plugins=[_NoShrinking()]))


def _modules_of_libraries() -> list[str]:
    """All imported modules but the tests' own, which pytest rewrites when it imports them, as it does plugins."""
    return [name for name, module in sys.modules.items() if name != "__main__" and not _is_test(module)]


def _is_test(module: ModuleType) -> bool:
    rewritten = type(getattr(module, "__loader__", None)).__name__ == "AssertionRewritingHook"
    return rewritten and "site-packages" not in str(getattr(module, "__file__", ""))


class _NoShrinking:
    """Lets hypothesis stop at the first failing example instead of looking for the smallest one."""

    def pytest_sessionstart(self) -> None:
        if "hypothesis" in sys.modules:
            from hypothesis import Phase, settings

            settings.register_profile("mutants", parent=settings.default, phases=(Phase.explicit, Phase.generate))
            settings.load_profile("mutants")


class _Holder:
    """Refuses to import some modules."""

    def __init__(self, held: Sequence[str]):
        self.held = frozenset(held)

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        """Raises ImportError for a module that is held back; leaves all others to the next finder."""
        if name in self.held:
            raise ImportError(f"{name} is held back for its mutants")


def place_mutant() -> None:
    """Puts the mutant that the environment variables name in the place of its module; does nothing without them."""
    if SOURCE in os.environ:
        finder = _MutantFinder(os.environ[MODULE], os.environ[ORIGINAL], os.environ[SOURCE])
        sys.meta_path.insert(0, finder)


class _MutantLoader(importlib.machinery.SourceFileLoader):
    """Loads a module whose text lies elsewhere; never from compiled files, which hold the original."""

    def __init__(self, name: str, original: str, source: str):
        super().__init__(name, original)
        self.source = source

    def get_data(self, path: str) -> bytes:
        return super().get_data(self.source if path == self.path else path)

    def get_code(self, fullname: str) -> Any:
        return compile(self.get_data(self.path), self.path, "exec", dont_inherit=True)


class _MutantFinder:
    """Finds the mutant instead of its module."""

    def __init__(self, name: str, original: str, source: str):
        self.name, self.original, self.source = name, original, source

    def find_spec(self, name: str, path: object = None, target: object = None) -> importlib.machinery.ModuleSpec | None:
        """Returns where the mutant lies; None for every other module."""
        if name != self.name:
            return None
        is_package = self.original.endswith("__init__.py")
        return importlib.util.spec_from_file_location(
            name,
            self.original,
            loader=_MutantLoader(name, self.original, self.source),
            submodule_search_locations=[os.path.dirname(self.original)] if is_package else None,
        )
