"""Sweeps from files to a page."""

import json
from dataclasses import replace

import pytest
import yaml

from hashnerf.errors import UserError
from hashnerf.tradeoff import Tradeoff, run_tradeoff
from tests.hashnerf.sweeps import write_sweep


@pytest.fixture
def config(tmp_path):
    write_sweep(tmp_path)
    report = {"run": {"machine": "m", "commit": "c"}, "seconds_total": 60.0}
    (tmp_path / "report.json").write_text(json.dumps(report))
    whole = {"town": {"reports": {"fast": str(tmp_path / "report.json")}, "figures": {}}}
    (tmp_path / "whole.yaml").write_text(yaml.safe_dump(whole))
    places = {"folder": "sweeps", "whole_runs": "whole.yaml", "runs": "runs", "out": "docs/results"}
    return Tradeoff(**{key: str(tmp_path / place) for key, place in places.items()}, most=3)


def test_a_page_and_its_charts_are_written(config, tmp_path):
    assert run_tradeoff(config, tmp_path, "python a.py", lambda line: None) == []
    text = (tmp_path / "docs/results/speed_accuracy.md").read_text()
    assert "`python a.py` writes this page" in text and "## A small sweep" in text and "3 of 6 rows" in text
    assert "![Accuracy against cost](speed_accuracy_small.png)" in text and "**town**" in text
    assert (tmp_path / "docs/results/speed_accuracy_small.png").read_bytes().startswith(b"\x89PNG")


def test_the_page_keeps_sweeps_that_are_not_run_now(config, tmp_path):
    run_tradeoff(config, tmp_path, "", lambda line: None)
    write_sweep(tmp_path).with_name("other.yaml").write_text((tmp_path / "sweeps/small.yaml").read_text())
    said = []
    run_tradeoff(replace(config, sweeps=("other",), most=1), tmp_path, "", said.append)
    assert all(line.startswith("other") for line in said)
    text = (tmp_path / "docs/results/speed_accuracy.md").read_text()
    assert "speed_accuracy_small.png" in text and "speed_accuracy_other.png" in text


def test_failed_rows_are_handed_back(config, tmp_path):
    (tmp_path / "fake.py").write_text("print('no luck'); raise SystemExit(2)")
    failed = run_tradeoff(config, tmp_path, "", lambda line: None)
    assert [one.reason for one in failed] == ["train ended with status 2: no luck"] * 3
    assert "**base** failed: train ended" in (tmp_path / "docs/results/speed_accuracy.md").read_text()


def test_wrong_input_is_a_sentence(config, tmp_path):
    with pytest.raises(UserError, match=r"sweeps: 'smal' is not in .*; did you mean 'small'"):
        run_tradeoff(replace(config, sweeps=("smal",)), tmp_path, "")
    for key in ("workers", "most"):
        with pytest.raises(UserError, match=f"{key} is -1"):
            replace(config, **{key: -1})
