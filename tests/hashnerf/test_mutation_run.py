"""Mutation runs on a toy package: what is noticed, what is not, and what never ends."""

import os
import time
from pathlib import Path

import pytest

from hashnerf.errors import UserError
from hashnerf.mutants import Mutant
from hashnerf.mutation_run import Limits, MutationResult, Tried, plan_mutants, run_mutants

CLAMP = "def clamp(x):\n    if x > 3:\n        return 3\n    return x\n"
COUNT = "def count(n):\n    while n > 0:\n        n -= 1\n    return n\n"
MODULES = {
    "__init__": "",
    "clamp": CLAMP,
    "count": COUNT,
    "far": "def f():\n    return 7\n",
    "started": "NUMBER = 7\n",
    "table": "NAMES = {1: 'a'}\nNAME = NAMES[1]\n",
    "end": "import os\n\ndef f(code):\n    if code == 3:\n        os.abort()\n",
}
CLAMP_TEST = """
import pytest
from toy.clamp import clamp

@pytest.mark.parametrize(("x", "wanted"), [(2.5, 2.5), (3.5, 3), (4, 3), (5, 3)])
def test_clamp(x, wanted):
    assert clamp(x) == wanted
"""
STARTED_TEST = """
import subprocess, sys

def test_number():
    code = "import toy.started; print(toy.started.NUMBER)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "7\\n"
"""
TESTS = {
    "clamp": CLAMP_TEST,
    "count": "from toy.count import count\n\ndef test_count():\n    count(2)\n",
    "far": "import toy.far\n\ndef test_nothing():\n    pass\n",
    "others": "from toy.far import f\n\ndef test_f():\n    assert f() == 7\n",
    "started": STARTED_TEST,
    "table": "import toy.table\n\ndef test_nothing():\n    pass\n",
    "end": "from toy.end import f\n\ndef test_f():\n    f(4)\n",
}
PID_TEST = """
import os
from toy.count import count

def test_count():
    open("pid", "w").write(str(os.getpid()))
    count(2)
"""


def write_toy(folder: Path, tests: dict[str, str]) -> Path:
    """Writes a package of small modules with tests and returns its folder."""
    for place, texts in (("toy", MODULES), ("tests", {f"test_{name}": text for name, text in tests.items()})):
        (folder / place).mkdir()
        for name, text in texts.items():
            (folder / place / f"{name}.py").write_text(text)
    return folder


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory) -> dict[str, dict[str, str]]:
    """What became of the mutants of each file, by what they change; without those of the loop, which may not end."""
    toy = write_toy(tmp_path_factory.mktemp("project"), TESTS)
    files = [f"toy/{name}.py" for name in MODULES]
    planned = [(file, mutant) for file, mutant in plan_mutants(toy, files) if mutant.before[:1] != "n"]
    found: dict[str, dict[str, str]] = {name: {} for name in MODULES}
    for one in run_mutants(toy, planned, "tests", Limits(workers=2, seconds=60.0)):
        found[Path(one.file).stem][f"{one.before} -> {one.after}"] = one.outcome
    assert {path.name: path.read_text() for path in (toy / "toy").glob("*.py")} == {
        f"{name}.py": text for name, text in MODULES.items()
    }
    return found


def test_good_tests_kill(outcomes):
    assert outcomes["clamp"] == {
        "x > 3 -> x >= 3": "survived",  # 3 either way: no fault at all
        "x > 3 -> x <= 3": "killed",
        "x > 3 -> x > 4": "killed",  # clamp(3.5)
        "return 3 -> return None": "killed",
        "return 3 -> return 4": "killed",
        "return x -> return None": "killed",
    }


def test_bad_tests_let_live(outcomes):
    assert outcomes["count"] == {"return n -> return None": "survived"}


def test_tests_of_other_modules_count(outcomes):
    assert outcomes["far"] == {"return 7 -> return None": "killed", "return 7 -> return 8": "killed"}


def test_programs_that_the_tests_start_get_the_mutant(outcomes):
    assert outcomes["started"] == {"NUMBER = 7 -> NUMBER = 8": "killed"}


def test_a_mutant_that_cannot_be_imported_is_killed(outcomes):
    assert set(outcomes["table"].values()) == {"killed"} and len(outcomes["table"]) == 2


def test_a_mutant_that_ends_the_process_is_no_kill(outcomes):
    assert outcomes["end"]["code == 3 -> code != 3"] == "error"


def endless(toy: Path) -> tuple[str, Mutant]:
    """The mutant that counts for ever."""
    return next(one for one in plan_mutants(toy, ["toy/count.py"]) if one[1].after == "pass")


def test_an_endless_mutant_is_ended(tmp_path):
    toy = write_toy(tmp_path, {"count": PID_TEST})
    (one,) = run_mutants(toy, [endless(toy)], "tests", Limits(factor=1.0, seconds=2.0))
    assert one == Tried("toy/count.py", 3, "n -= 1", "pass", "timed out")
    with pytest.raises(ProcessLookupError):
        os.kill(int((toy / "pid").read_text()), 0)


def test_stopping_early_ends_what_runs(tmp_path):
    toy = write_toy(tmp_path, {"count": PID_TEST})
    last = plan_mutants(toy, ["toy/count.py"])[-1]
    running = run_mutants(toy, [last, endless(toy)], "tests", Limits(seconds=600.0))
    assert next(running).outcome == "survived"
    before = (toy / "pid").read_text()
    while (now := (toy / "pid").read_text()) in ("", before):
        time.sleep(0.01)
    running.close()
    with pytest.raises(ProcessLookupError):
        os.kill(int(now), 0)


def test_tests_that_fail_without_a_mutant_are_refused(tmp_path):
    toy = write_toy(tmp_path, {"clamp": CLAMP_TEST.replace("(5, 3)", "(5, 4)")})
    with pytest.raises(UserError, match=r"test_clamp\.py: fail without any mutant; mend them first: .*\[5-4\]"):
        list(run_mutants(toy, plan_mutants(toy, ["toy/clamp.py"]), "tests"))


def test_missing_tests_and_empty_files_are_refused(tmp_path):
    toy = write_toy(tmp_path, {})
    with pytest.raises(UserError, match="tests: there are no test files; check the path"):
        list(run_mutants(toy, plan_mutants(toy, ["toy/clamp.py"]), "tests"))
    with pytest.raises(UserError, match=r"toy/__init__\.py: has nothing to mutate"):
        plan_mutants(toy, ["toy/__init__.py"])
    with pytest.raises(UserError, match="no file: has nothing to mutate"):
        plan_mutants(toy, [])
    (toy / "toy/clamp.py").write_text("if")
    with pytest.raises(UserError, match=r"toy/clamp\.py: is no Python module"):
        plan_mutants(toy, ["toy/clamp.py"])


def test_a_sample_is_a_part_in_order_and_repeats(tmp_path):
    toy = write_toy(tmp_path, {})
    files = ["toy/clamp.py", "toy/count.py"]
    whole, part = plan_mutants(toy, files), plan_mutants(toy, files, share=0.5, seed=1)
    assert len(part) == round(0.5 * len(whole)) and part == [one for one in whole if one in part]
    assert part == plan_mutants(toy, files, share=0.5, seed=1) != plan_mutants(toy, files, share=0.5, seed=2)


def test_the_result_counts_and_names_the_survivors():
    names = ["killed", "timed out", "survived", "error"]
    tried = tuple(Tried(f"{name[0]}.py", 1, "a", "b", name) for name in [*names, "killed"])
    result = MutationResult(tried)
    assert result.counts == {"killed": 2, "timed out": 1, "survived": 1, "error": 1}
    assert result.killed_share == pytest.approx(3 / 5) and result.survivors == tried[2:4]
    written = result.as_json()
    assert written["mutants"] == 5 and written["files"]["k.py"] == {"mutants": 2, "survivors": 0}
    assert written["survivors"][0] == {"file": "s.py", "line": 1, "before": "a", "after": "b", "outcome": "survived"}
