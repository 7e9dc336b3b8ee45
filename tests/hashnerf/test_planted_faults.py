"""Planted faults: each can still be planted, a real one is caught, and a harmless change is not."""

import subprocess
import sys
from pathlib import Path

import pytest

from hashnerf.errors import UserError
from hashnerf.planted_faults import Fault, failing_tests, fault_line, read_faults

ROOT = Path(__file__).resolve().parents[2]
FAULTS = read_faults(ROOT / "tests/planted_faults.yaml")
CLAMP = """
clamp:
  kernel: exponential
  fault: not clamped
  file: hashnerf/activations.py
  old: ".clamp(max=EXPONENT_LIMIT))"
  new: ")"
  tests: [tests/hashnerf/test_activations.py]
"""
COMMENT = """
comment:
  kernel: exponential
  fault: another comment
  file: hashnerf/activations.py
  old: "# exp(15) is beyond float16"
  new: "# too large for float16"
  tests: [tests/hashnerf/test_activations.py]
"""


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_every_fault_can_be_planted(fault):
    text = (ROOT / fault.file).read_text(encoding="utf-8")
    changed = fault.planted_in(text)
    assert changed != text
    compile(changed, fault.file, "exec")
    assert all((ROOT / test.split("::")[0]).is_file() for test in fault.tests)


def test_faults_lie_in_many_kernels():
    assert len(FAULTS) >= 8 and len({fault.kernel for fault in FAULTS}) >= 8


@pytest.mark.parametrize("text", ["", "guard guard"])
def test_text_that_does_not_match_once_is_refused(text):
    with pytest.raises(UserError, match=r"clamp: its old text is found [02] times in a\.py; let it match once"):
        Fault("clamp", "k", "f", "a.py", "guard", "", ()).planted_in(text)


@pytest.mark.parametrize("change", [("  kernel: exponential\n", ""), ("  new:", "  newer:"), ("  tests:", "  test:")])
def test_an_entry_with_other_keys_is_refused(tmp_path, change):
    (tmp_path / "faults.yaml").write_text(CLAMP.replace(*change))
    with pytest.raises(UserError, match=r"clamp: .*give kernel, fault, file, old, new and tests"):
        read_faults(tmp_path / "faults.yaml")


def test_a_fault_that_no_test_notices_is_not_caught():
    fault = Fault("a", "kernel", "fault", "a.py", "", "", ())
    assert fault_line(fault, []) == ("kernel", "fault", "none", "**no**")
    assert fault_line(fault, ["test_a", "test_b"]) == ("kernel", "fault", "`test_a`<br>`test_b`", "yes")


def test_failing_tests_are_named_without_their_parameters(tmp_path):
    (tmp_path / "test_a.py").write_text(
        "import pytest\n@pytest.mark.numeric\n@pytest.mark.parametrize('x', [0.5, 1.5])\n"
        "def test_n01_x(x):\n    assert not x\ndef test_no_row():\n    assert False\n"
    )
    assert failing_tests(tmp_path, ["test_a.py"]) == ["test_n01_x"]


def test_a_fault_is_caught_and_a_comment_is_not(tmp_path):
    (tmp_path / "faults.yaml").write_text(CLAMP + COMMENT)
    command = [sys.executable, "scripts/plant_faults.py", "--faults", str(tmp_path / "faults.yaml")]
    done = subprocess.run(
        [*command, "--page", str(tmp_path / "page.md")], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1, "the comment goes unnoticed"
    assert "clamp: caught" in done.stdout and "comment: NOT caught" in done.stdout
    page = (tmp_path / "page.md").read_text()
    assert "| exponential | not clamped | `test_n20" in page
    assert "| exponential | another comment | none | **no** |" in page
