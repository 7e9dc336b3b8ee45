"""The study of derived capacity: its stages, what it reads of a run, and what its page says."""

import json

import pytest

from hashnerf import capacity_study
from hashnerf.capacity_study import (
    CapacityStudy,
    Fit,
    empty_share,
    mean_fit,
    read_fit,
    run_study,
    scenes_of,
    study_table,
    write_study,
)
from hashnerf.errors import UserError

FIELD = {"levels": 7, "log2_table_size": 15, "finest_resolution": 157}
GOOD, DEAR = Fit(20.0, 500.0, 28.5, FIELD, 60.0, 16000), Fit(100.0, 900.0, 28.6, FIELD, 200.0, 16000)
EMPTY = Fit(2.0, 400.0, 35.0, FIELD, 1.2, 0)
NAMES = ("empty sky", "one box", "intersection, one state", "mini-city, exact poses")


def found(chosen: Fit = GOOD, empty: Fit = EMPTY) -> dict:
    return {name: {"chosen": empty if name == "empty sky" else chosen, "fixed": DEAR} for name in NAMES}


def test_a_row_by_hand():
    row = study_table(found()).rows[1]
    assert row[:4] == ("one box", "7 x 2^15, 157 cells", "28.50 dB (0.00)", "28.60 dB (0.00)")
    assert row[4] == "-0.10 dB (met)" and row[7] == "0.20 (met)"
    slow = Fit(51.0, 500.0, 28.39, FIELD, 60.0, 16000)
    row = study_table(found(slow)).rows[1]
    assert row[4] == "-0.21 dB (**missed**)" and row[7] == "0.51 (**missed**)"


def test_seeds_are_averaged():
    fit = mean_fit([Fit(10.0, 400.0, 28.0, FIELD, 50.0, 0), Fit(20.0, 600.0, 28.5, FIELD, 70.0, 3)])
    assert fit == Fit(15.0, 500.0, 28.25, FIELD, 60.0, 3, 0.5)


def test_the_empty_sky_beside_the_town():
    assert empty_share(found()) == pytest.approx(1.2 / 60)


@pytest.mark.parametrize(
    ("empty", "verdict"),
    [
        (EMPTY, "(met, target"),
        (Fit(2.0, 400.0, 35.0, FIELD, 1.2, 10), "(**missed**, target"),
        (Fit(2.0, 400.0, 35.0, FIELD, 6.0, 0), "(**missed**, target"),
    ],
)
def test_the_page_judges_the_empty_sky(empty, verdict, tmp_path):
    config = CapacityStudy(page=str(tmp_path / "new" / "capacity.md"))
    write_study(found(empty=empty), config, "about")
    text = (tmp_path / "new" / "capacity.md").read_text()
    assert verdict in text and "| one box |" in text and "about" in text


def test_a_run_is_read(tmp_path):
    (tmp_path / "field").mkdir()
    results = {"seconds": 9.0, "peak_memory_mb": 300.0, "psnr_db": 25.0, "field": FIELD}
    (tmp_path / "reconstruction.json").write_text(json.dumps(results))
    # 100 ms a step in the first half, then 20 and 30 ms; 7, 6 and 5 samples
    lines = [(0, 0.0, 9), (20, 2.0, 8), (40, 4.0, 7), (60, 4.4, 6), (80, 5.0, 5)]
    text = "\n".join(
        json.dumps({"step": s, "seconds": 3 * t, "processor_seconds": t, "samples": n}) for s, t, n in lines
    )
    (tmp_path / "field" / "metrics.jsonl").write_text(text + "\n")
    fit = read_fit(tmp_path, 80)
    assert fit.step_ms == pytest.approx(25.0) and fit.samples == 6 and fit.psnr_db == 25.0
    assert fit.seconds == pytest.approx(80 * 5.0 / 81), "of processor, not on the wall"


def test_every_scene_is_made_and_fitted_both_ways(tmp_path, monkeypatch):
    commands = []
    monkeypatch.setattr(capacity_study, "run_stage", lambda name, command, folder: commands.append((name, command)))
    monkeypatch.setattr(capacity_study, "read_fit", lambda folder, steps: GOOD)
    config = CapacityStudy(runs=str(tmp_path), steps=5, photographs="photos")
    assert list(run_study(config)) == [*NAMES, "photographs, 250 px"] == list(scenes_of(config))
    assert [name for name, _ in commands][:3] == [
        "pictures of empty sky",
        "empty sky, chosen, seed 0",
        "empty sky, chosen, seed 1",
    ]
    assert not any(name == "pictures of photographs, 250 px" for name, _ in commands)
    chosen, fixed = (
        next(c for name, c in commands if name == f"one box, {way}, seed 1") for way in ("chosen", "fixed")
    )
    assert [*chosen[:1], "--field.levels" in chosen] == ["scripts/train_static_nerf.py", False]
    assert " ".join(fixed).endswith("--field.levels 16 --field.log2_table_size 19 --field.finest_resolution 2048")
    assert "--steps 5" in " ".join(chosen)


def test_no_steps_are_refused():
    with pytest.raises(UserError, match="steps is 0"):
        CapacityStudy(steps=0)
