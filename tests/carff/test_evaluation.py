"""From a run to a report, with a run that knows everything."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from carff import evaluate_scenes, evaluation
from carff.report import REQUIRED_KEYS
from hashnerf.targets import lookup, reason_for

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def report(tiny_evaluation, monkeypatch) -> tuple[Path, list[str]]:
    (tiny_evaluation.config.folder / "nerf_birds_eye").mkdir()
    nerf = tiny_evaluation.model.nerf
    monkeypatch.setattr(evaluate_scenes, "load_nerf", lambda config, scene, held_out: (nerf, {"seconds": 1.0}))
    cost = {"seconds": 1.0, "peak_memory_mb": 1.0}
    monkeypatch.setattr("carff.evaluate_costs.load_nerf", lambda config, scene, held_out: (nerf, cost))
    monkeypatch.setattr(evaluation, "load_evaluation_data", lambda config: tiny_evaluation)
    monkeypatch.setattr(evaluation, "set_threads", lambda count: None)
    parts: list[str] = []
    return evaluation.evaluate(tiny_evaluation.config, "the command", lambda name, seconds: parts.append(name)), parts


def test_every_required_figure_has_a_value_or_a_reason(report):
    page, parts = report
    document = json.loads((page.parent / "report.json").read_text())
    for key in REQUIRED_KEYS:
        assert lookup(document, key) is not None or reason_for(key, document["not_run"]), key
    assert document["nerf"]["state_identified"] == document["probe"]["accuracy"] == 1.0
    assert document["plan"]["risk"]["n35"]["hazard_success"] == 1.0
    assert document["run"]["command"] == "the command" and document["run"]["scenario"] == "tiny"
    # The data set has no embedded world behind it, and this run no record of its training curve.
    assert set(document["not_run"]) == {"closed_loop", "approach", "psnr_train"}
    assert parts == ["loading", *evaluation.PARTS] and set(document["evaluation_seconds"]) == set(parts)
    text = page.read_text()
    assert text.count("data:image/png;base64") == 13 and "://" not in text, "one file that opens offline"


def test_the_evaluation_knows_no_embedded_world():
    code = "import sys, carff.evaluation; sys.exit(any(name.split('.')[0] == 'worlds' for name in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0
