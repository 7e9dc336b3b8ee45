from pathlib import Path

from aerial2ground.guard.faults import Fault

DEPLOY = Path(__file__).resolve().parents[3] / "docs" / "deploy.md"


def test_every_fault_says_what_to_do():
    for fault in Fault:
        what, _, to_do = fault.value.partition(": ")
        assert what and to_do, fault


def test_the_operators_page_explains_every_fault_and_no_other():
    lines = DEPLOY.read_text(encoding="utf-8").splitlines()
    explained = [line.split("`")[1] for line in lines if line.startswith("| `") and line.split("`")[1].isupper()]
    assert sorted(explained) == sorted(fault.name for fault in Fault)
