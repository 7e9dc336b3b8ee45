"""Presets of whole runs side by side."""

import json
from pathlib import Path

import pytest
import yaml

from hashnerf.errors import UserError
from hashnerf.whole_runs import whole_runs_section

ROOT = Path(__file__).resolve().parents[2]


def section(folder, reports, figures=None):
    files = {}
    for name, (seconds, quality) in reports.items():
        report = {"run": {"machine": "m", "commit": "c"}, "seconds_total": seconds, "a": {"quality": quality}}
        files[name] = str(folder / f"{name}.json")
        Path(files[name]).write_text(json.dumps(report))
    figures = figures or {"quality": {"key": "a.quality", "unit": "dB", "better": "more"}}
    path = folder / "whole.yaml"
    path.write_text(yaml.safe_dump({"town": {"reports": files, "figures": figures}}))
    return whole_runs_section(path)


def test_presets_stand_beside_each_other_and_none_is_dominated(tmp_path):
    text = section(tmp_path, {"fast": (60, 20.0), "balanced": (600, 25.0)})
    assert "| fast | 1.0 min | 20.0 dB | m | c |" in text and "| balanced | 10.0 min | 25.0 dB | m | c |" in text
    assert "**town**" in text and text.endswith("None dominates another.")


def test_a_dominated_preset_is_named(tmp_path):
    assert section(tmp_path, {"fast": (60, 25.0), "balanced": (600, 20.0)}).endswith("Dominated: balanced.")
    less = {"quality": {"key": "a.quality", "unit": "m", "better": "less"}}
    assert section(tmp_path, {"fast": (60, 25.0), "balanced": (600, 20.0)}, less).endswith("None dominates another.")


def test_a_report_without_the_figure_is_a_sentence(tmp_path):
    missing = {"quality": {"key": "b.quality", "unit": "dB", "better": "more"}}
    with pytest.raises(UserError, match=r"lacks b\.quality; publish the report again"):
        section(tmp_path, {"fast": (60, 20.0)}, missing)


def test_no_published_preset_is_dominated(monkeypatch):
    monkeypatch.chdir(ROOT)
    text = whole_runs_section(Path("configs/whole_runs.yaml"))
    assert text.count("None dominates another.") == 2 and "Dominated" not in text
