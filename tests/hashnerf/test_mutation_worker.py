"""A mutant in the place of its module, in the programs that tests start."""

import os
import py_compile
import subprocess
import sys
from pathlib import Path

import pytest

from hashnerf.mutation_worker import MODULE, ORIGINAL, PLACE, SOURCE

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def package(tmp_path) -> Path:
    """A package whose numbers are 1, compiled, with a mutant of each file beside it whose numbers are 2."""
    (tmp_path / "toy").mkdir()
    for name in ("__init__", "part"):
        (tmp_path / "toy" / f"{name}.py").write_text(
            "NUMBER = 1\nif __name__ == '__main__':\n    print('run', NUMBER)\n"
        )
        py_compile.compile(str(tmp_path / "toy" / f"{name}.py"))
        text = (tmp_path / "toy" / f"{name}.py").read_text()
        (tmp_path / f"{name}_mutant.py").write_text(text.replace("1", "2"))
    assert said(tmp_path, "import toy.part, toy; print(toy.part.NUMBER, toy.NUMBER)") == "1 1\n"
    return tmp_path


def said(folder: Path, code: str, mutant: str = "", arguments: tuple[str, ...] = ()) -> str:
    """What Python prints for some code, or a module, with a mutant in place."""
    (folder / "sitecustomize.py").write_text(PLACE)
    variables = {"PYTHONPATH": f"{folder}{os.pathsep}{ROOT}"}
    if mutant:
        module = "toy" if mutant == "__init__" else f"toy.{mutant}"
        variables |= {MODULE: module, ORIGINAL: str(folder / "toy" / f"{mutant}.py")}
        variables |= {SOURCE: str(folder / f"{mutant}_mutant.py")}
    command = [sys.executable, *(arguments or ("-c", code))]
    return subprocess.run(command, env=os.environ | variables, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize(("mutant", "numbers"), [("part", "2 1\n"), ("__init__", "1 2\n")])
def test_only_the_mutant_changes(package, mutant, numbers):
    assert said(package, "import toy.part, toy; print(toy.part.NUMBER, toy.NUMBER)", mutant) == numbers


def test_a_mutant_can_be_run_as_a_program(package):
    assert said(package, "", "part", ("-m", "toy.part")) == "run 2\n"


def test_a_mutant_knows_the_place_of_its_module(package):
    code = "import toy.part as p; print(p.__file__, p.__loader__.get_source(p.__name__) == open(p.__file__).read())"
    assert said(package, code, "part") == f"{package / 'toy/part.py'} False\n"
