"""The study of the road prior: pairs, intervals, and what is not there."""

import json

import pytest

from aerial2ground.prior_study import FIGURES, STARTS, interval, read_figures, study_tables, trials
from aerial2ground.road_prior import VARIANTS
from hashnerf.errors import UserError


def test_an_interval_by_hand():
    # mean 2, deviation 1, t of two degrees of freedom 4.303: 4.303 / sqrt(3)
    assert interval([1.0, 2.0, 3.0]) == pytest.approx((2.0, 2.484), abs=1e-3)


def test_every_start_variant_and_seed_has_a_folder_of_its_own():
    study = trials(3)
    assert len(study) == len({trial.name for trial in study}) == 3 * len(STARTS) * len(VARIANTS)
    full = next(trial for trial in study if trial.name == "opaque_ground_full_2")
    assert full.options == ("--seed", "2", "--reconstruction.opaque_start", "true")
    with pytest.raises(UserError, match="at least 2"):
        trials(1)


def measured(folder, change):
    study = trials(3)
    for trial in study:
        ground = dict.fromkeys(FIGURES, 20.0 + trial.seed) | change(trial)
        (folder / trial.name).mkdir(parents=True)
        (folder / trial.name / "reconstruction.json").write_text(json.dumps({"ground": ground}))
    return study


def test_a_gain_in_every_pair_is_significant_whatever_the_seeds_differ_by(tmp_path):
    better = {"none": 0.0, "colour": 0.01, "colour_depth": 0.0, "full": 1.0}

    def change(trial):
        noise = 0.1 * trial.seed * (trial.variant == "colour") * (-1) ** trial.seed
        return {"road_psnr_db": 20.0 + trial.seed + better[trial.variant] + noise}

    study = measured(tmp_path, change)
    lines = study_tables(read_figures(tmp_path, study)).splitlines()
    assert any(line.startswith("| fog | none | 21.00 ± 2.48 ") for line in lines)
    gains = [line for line in lines if line.startswith("| fog | full")][1]
    assert "| **+1.00 ± 0.00** |" in gains
    assert "**" not in [line for line in lines if line.startswith("| fog | colour |")][1]


def test_what_is_missing_is_named(tmp_path):
    study = measured(tmp_path, lambda trial: {})
    (tmp_path / study[4].name / "reconstruction.json").unlink()
    with pytest.raises(UserError, match=f"{study[4].name}/reconstruction.json: was not measured"):
        read_figures(tmp_path, study)
    (tmp_path / study[4].name / "reconstruction.json").write_text(json.dumps({"ground": {"hidden_road_psnr_db": None}}))
    with pytest.raises(UserError, match="no road is hidden from above"):
        read_figures(tmp_path, study)
