import json
import typing
from types import SimpleNamespace

from aerial2ground.bridge import try_parts
from aerial2ground.bridge.bridge_page import PARTS as SHOWN
from aerial2ground.bridge.try_parts import PARTS, try_coverage, try_faults
from scripts.try_bridge import Part


def test_every_part_of_the_page_can_be_measured():
    assert set(PARTS) == set(typing.get_args(Part)) == set(SHOWN) - {"mutants"}


def test_a_fault_is_done_as_often_as_asked(tmp_path, monkeypatch):
    trial = next(one for one in try_parts.TRIALS if one.name == "e_stop")
    monkeypatch.setattr(try_parts, "TRIALS", (trial,))
    (found,) = try_faults(SimpleNamespace(repetitions=2), tmp_path)
    assert found["name"] == "e_stop" and len(found["took"]) == 2
    assert all(0 <= seconds < 2 * trial.allowed for seconds in found["took"])
    assert len(list(tmp_path.iterdir())) == 1, "one start of the bridge is enough for a fault that can be mended"
    json.dumps(found, allow_nan=False)


def test_the_guard_is_covered_to_the_last_branch(tmp_path):
    assert try_coverage(SimpleNamespace(), tmp_path)["percent"] == 100
