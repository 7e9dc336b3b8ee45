"""Planted faults: whether the tests of the numbered rows notice when a guard is taken out of a kernel.

A fault is one exact piece of text of one file and what stands there instead. It is planted in a copy of the tracked
files, one at a time; it is caught when a test fails that passes without it.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hashnerf.command_line import read_yaml
from hashnerf.errors import UserError
from hashnerf.numeric_rows import read_run

HEADER = ("kernel", "fault", "tests that failed", "caught")


@dataclass(frozen=True)
class Fault:
    """A guard that is taken out."""

    name: str
    kernel: str
    fault: str
    """What is wrong with the kernel then."""
    file: str
    """The file it stands in, from the root of the repository."""
    old: str
    """Text of that file, found there exactly once."""
    new: str
    """What stands there instead."""
    tests: tuple[str, ...]
    """What pytest is to run: files or single tests with the rows that should notice."""

    def planted_in(self, text: str) -> str:
        """Returns the file's text with the fault; raises UserError unless `old` is found exactly once."""
        count = text.count(self.old)
        if count != 1:
            raise UserError(f"{self.name}: its old text is found {count} times in {self.file}; let it match once")
        return text.replace(self.old, self.new)


def read_faults(path: Path) -> list[Fault]:
    """Returns the faults of a YAML file; raises UserError for an entry with missing or unknown keys."""
    faults = []
    for name, about in read_yaml(path).items():
        try:
            faults.append(Fault(name, **{**about, "tests": tuple(about["tests"])}))
        except (KeyError, TypeError) as error:
            raise UserError(f"{path}: {name}: {error}; give kernel, fault, file, old, new and tests") from error
    return faults


def copy_tracked(root: Path, folder: Path) -> None:
    """Copies the files that git tracks, as they are now; raises UserError outside a git checkout."""
    try:
        listing = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, check=True, text=True).stdout
    except (OSError, subprocess.CalledProcessError) as error:
        raise UserError(f"{root}: is no git checkout, so nothing says which files to copy; clone it") from error
    for name in filter(None, listing.split("\0")):
        if (root / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(root / name, folder / name)


def failing_tests(folder: Path, tests: Sequence[str]) -> list[str]:
    """Returns the names of the rows' tests that fail in a copy, in the order of the files.

    Raises UserError where they cannot be run at all.
    """
    report = folder / "rows.xml"
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--tb=no", "-m", "numeric"]
    # another checkout may be the installed one: the copy comes first
    done = subprocess.run(
        [*command, f"--junitxml={report}", "-o", "junit_family=legacy", *tests],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
    )
    if done.returncode not in (0, 1):
        raise UserError(f"{' '.join(tests)}: pytest could not run them; it ends with: {done.stdout[-300:].strip()}")
    passed = read_run(report).passed
    return list(dict.fromkeys(test.split("[")[0].split(".")[-1] for test, well in passed.items() if not well))


class FaultyCopy:
    """A copy of the repository in which faults are planted and taken back."""

    def __init__(self, root: Path, folder: Path):
        copy_tracked(root, folder)
        self.folder = folder
        self.sound: set[tuple[str, ...]] = set()

    def failures(self, fault: Fault) -> list[str]:
        """Returns which tests fail with a fault; raises UserError where some fail without it."""
        if fault.tests not in self.sound:
            broken = failing_tests(self.folder, fault.tests)
            if broken:
                raise UserError(f"{', '.join(broken)}: fail without any fault; mend them first")
            self.sound.add(fault.tests)
        file = self.folder / fault.file
        text = file.read_text(encoding="utf-8")
        file.write_text(fault.planted_in(text), encoding="utf-8")
        try:
            return failing_tests(self.folder, fault.tests)
        finally:
            file.write_text(text, encoding="utf-8")


def fault_line(fault: Fault, failed: Sequence[str]) -> tuple[str, ...]:
    """Returns the fault's line of the page's table."""
    tests = "<br>".join(f"`{test}`" for test in failed)
    return fault.kernel, fault.fault, tests or "none", "yes" if failed else "**no**"
