import base64
import json
import os
import re

import numpy as np
import pytest

from carff.planning_metrics import Episode, closed_loop_results, plan_results, planning_table
from carff.report import PANEL_NAMES, REQUIRED_KEYS, write_report
from hashnerf.errors import UserError
from hashnerf.figure_style import new_figure, png_bytes
from hashnerf.run_info import RunInfo
from hashnerf.targets import lookup

RUN = RunInfo("demo", "fast", "intersection", "make demo", "2 cores", "2026-01-01 12:00", "abc1234", 0, "Python 3.11")


def _fake_results(states: int = 6, branches: int = 2) -> dict:
    """Results of a run that meets every target, of the shape that an evaluation makes."""
    hazard = np.array([True, False])
    right = np.array([[False] * 30, [True] * 30])
    rows = planning_table({(rule, n): right for rule in ("risk", "paper") for n in (2, 10, 35)}, hazard)
    episodes = [
        Episode(policy, branch, branch == 1, policy == "always_go" and branch == 1, False, False, 5.0, 4)
        for policy in ("risk", "paper", "oracle", "always_go")
        for branch in range(branches)
    ]
    chance = [1 / branches] * branches
    ambiguous = {"views": 4, "mean_probability": chance, "mean_frequency": chance, "error": 0.0}
    visible = {name: {"views": 4, "ece": 0.01, "mae": 0.02, "bins": []} for name in ("none", "partial", "full")}
    return {
        "seconds_total": 600.0,
        "decision_ms_n10": 80.0,
        "data": {"states": states, "cameras": 100, "branches": [f"branch {index}" for index in range(branches)]},
        "pcvae": {
            "psnr_train_db": np.float32(33.0),
            "svm_all": 0.78,
            "svm_ceiling": 0.8,
            "svm_visible": 0.98,
            "svm_visible_interval": np.array([0.97, 0.99]),
            "svm_visible_ceiling": 0.99,
            "svm_visible_heldout": 0.85,
            "svm_visible_heldout_ceiling": 1.0,
        },
        "nerf": {
            "psnr_matched_db": 26.0,
            "psnr_matched_heldout_db": 25.0,
            "psnr_unmatched_db": 22.0,
            "changed_px_db": 23.0,
            "changed_px_lead_db": 6.0,
            "state_identified": 1.0,
            "state_identified_count": states,
            "states": states,
            "psnr_matrix_db": [[None] * states] * states,
        },
        "forecast": {
            "branch_ece": 0.02,
            "ambiguous_branch_error": 0.01,
            "calibration": {"by_visibility": visible, "ambiguous": ambiguous},
        },
        "probe": {"accuracy": 0.99, "interval": [0.97, 1.0]},
        "plan": plan_results(rows),
        "closed_loop": closed_loop_results(episodes),
        "stages": [{"name": "PC-VAE", "seconds": 60.0, "peak_memory_mb": None}],
    }


def _strict_json(path) -> dict:
    def refuse(token: str):
        raise AssertionError(f"{token} is not JSON")

    return json.loads(path.read_text(), parse_constant=refuse)


def _without(results: dict, key: str) -> dict:
    *path, leaf = key.split(".")
    place = results
    for part in path:
        place = place[part]
    del place[leaf]
    return results


@pytest.fixture(scope="module")
def picture() -> bytes:
    return png_bytes(new_figure(0.3, 0.2))


def test_report_has_every_required_key_and_meets_its_targets(tmp_path, picture):
    page = write_report(tmp_path, RUN, _fake_results(), {name: picture for name in PANEL_NAMES})
    document = _strict_json(tmp_path / "report.json")
    assert page == tmp_path / "report.html" and document["run"]["commit"] == "abc1234"
    assert all(lookup(document, key) is not None for key in REQUIRED_KEYS)
    judged = [row for row in document["targets"] if row["target"] is not None]
    assert len(judged) == 18 and all(row["met"] for row in judged)
    assert "18 of 18 judged figures meet their target" in page.read_text()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.html", "report.json"]


def test_page_is_one_file_that_needs_no_network(tmp_path, picture):
    text = write_report(tmp_path, RUN, _fake_results(), {"contact_sheet": picture}).read_text()
    assert "http:" not in text and "https:" not in text and "<script" not in text and "@import" not in text
    sources = re.findall(r'src="([^"]*)"', text)
    assert sources == ["data:image/png;base64," + base64.b64encode(picture).decode()]
    anchors, ids = set(re.findall(r'href="#([^"]*)"', text)), set(re.findall(r'id="([^"]*)"', text))
    assert anchors and anchors <= ids


def test_misses_are_reported_as_misses(tmp_path):
    results = _fake_results()
    results["nerf"]["psnr_matched_db"] = 20.0
    text = write_report(tmp_path, RUN, results, {}).read_text()
    row = next(row for row in _strict_json(tmp_path / "report.json")["targets"] if row["key"] == "nerf.psnr_matched_db")
    assert row["met"] is False and row["measured"] == 20.0 and row["target"] == 24.5
    assert text.count("✗ missed") == 1 and "17 of 18" in text


@pytest.mark.parametrize(
    "key", ["pcvae.svm_ceiling", "plan.paper.n35.clear_success", "decision_ms_n10", "probe.accuracy"]
)
def test_a_missing_required_key_is_named_and_nothing_is_written(tmp_path, key):
    with pytest.raises(UserError, match=re.escape(key)):
        write_report(tmp_path, RUN, _without(_fake_results(), key), {})
    assert not any(tmp_path.iterdir())


def test_a_reason_stands_in_for_what_cannot_be_measured(tmp_path):
    results = _without(_fake_results(), "closed_loop")
    reasons = {"closed_loop": "the pictures are recordings, there is no world to drive in"}
    text = write_report(tmp_path, RUN, results, {}, reasons).read_text()
    assert text.count("not run: the pictures are recordings") == 2
    assert "Not run: the pictures are recordings" in text
    assert _strict_json(tmp_path / "report.json")["not_run"] == reasons


def test_single_branch_data_says_why_there_is_no_calibration(tmp_path):
    results = _fake_results(states=10, branches=1)
    results["forecast"] = {"branch_ece": None, "calibration": {"ece": None, "views": 4, "reason": "a single branch"}}
    reasons = {"forecast.branch_ece": "a single branch", "forecast.ambiguous_branch_error": "a single branch"}
    text = write_report(tmp_path, RUN, results, {}, reasons).read_text()
    assert "Not run: a single branch" in text
    assert _strict_json(tmp_path / "report.json")["forecast"]["branch_ece"] is None


@pytest.mark.parametrize(("states", "branches"), [(10, 1), (6, 2), (6, 3), (5, 3), (4, 2)])
def test_any_number_of_states_and_branches(tmp_path, states, branches):
    text = write_report(tmp_path, RUN, _fake_results(states, branches), {}).read_text()
    assert f"{states} of {states}" in text and f"branch {branches - 1}" in text


def test_numbers_that_are_not_finite_become_null_and_miss(tmp_path):
    results = _fake_results()
    results["nerf"]["psnr_matched_db"], results["nerf"]["psnr_min_db"] = float("nan"), np.float32(np.inf)
    text = write_report(tmp_path, RUN, results, {}).read_text()
    document = _strict_json(tmp_path / "report.json")
    assert document["nerf"]["psnr_matched_db"] is None and document["nerf"]["psnr_min_db"] is None
    assert "not finite" in text and "✗ missed" in text


def test_presets_without_targets_say_so(tmp_path):
    run = RunInfo(**(vars(RUN) | {"preset": "accurate"}))
    text = write_report(tmp_path, run, _fake_results(), {}).read_text()
    assert "has no targets" in text and "✓ met" not in text and "not judged" in text


def test_names_are_shown_as_text(tmp_path):
    run = RunInfo(**(vars(RUN) | {"name": "<b>bold & brave</b>"}))
    text = write_report(tmp_path, run, _fake_results(), {}).read_text()
    assert "&lt;b&gt;bold &amp; brave&lt;/b&gt;" in text and "<b>" not in text


def test_a_figure_that_no_section_shows_is_refused(tmp_path, picture):
    with pytest.raises(ValueError, match="contact_shet"):
        write_report(tmp_path, RUN, _fake_results(), {"contact_shet": picture})


def test_a_full_disk_leaves_the_old_report_and_no_remains(tmp_path, monkeypatch):
    write_report(tmp_path, RUN, _fake_results(), {})
    before = (tmp_path / "report.json").read_text()

    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(UserError, match="No space left"):
        write_report(tmp_path, RunInfo(**(vars(RUN) | {"name": "second"})), _fake_results(), {})
    assert (tmp_path / "report.json").read_text() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.html", "report.json"]


def test_the_same_results_give_the_same_page(tmp_path, picture):
    first = write_report(tmp_path, RUN, _fake_results(), {"tsne": picture}).read_bytes()
    assert write_report(tmp_path, RUN, _fake_results(), {"tsne": picture}).read_bytes() == first
