"""Files of a run become results with reasons; tests/aerial2ground/test_report.py has the missing ones."""

import json
from dataclasses import replace

import pytest

from aerial2ground import report_results as module
from aerial2ground.config import AerialConfig, EvaluationConfig
from aerial2ground.report_results import ablation_folder, add_costs, read_run
from hashnerf.errors import UserError
from hashnerf.pipeline import note
from tests.aerial2ground.fake_run import fake_run, save


@pytest.fixture
def fake(tmp_path) -> AerialConfig:
    """A finished run."""
    config = AerialConfig(name="fake", runs=str(tmp_path))
    fake_run(config)
    return config


def test_methods_come_in_the_order_of_the_papers_tables(fake):
    run = read_run(fake)
    assert list(run.results["table2"]["outer_loop"]) == ["expert", "imit", "imit_gv", "ours", "ours_gv"]
    assert list(run.results["table1"]) == run.towns == ["layout_0", "layout_1", "layout_2"]
    assert list(run.results["table1"]["layout_1"]) == ["baseline", "ours", "ours_imu"]
    assert run.trajectories == ["outer_loop", "left_turns", "right_turns"]
    assert run.results["policy"]["onnx_ms"] == 0.11 and run.reasons == {}


def test_as_many_towns_as_the_config_asks_for(fake):
    assert read_run(replace(fake, evaluation=EvaluationConfig(layouts=1))).towns == ["layout_0"]


def test_figures_that_no_pixel_supports_say_so(fake):
    ground = {"psnr_db": 20.0, "road_depth_rmse_m": None}
    save(ablation_folder(fake.folder, "none") / "reconstruction.json", {"ground": ground})
    assert read_run(fake).reasons == {"ground.road_depth_rmse_m.none": "no pixel of that kind is in the views"}


def test_the_report_counts_itself_and_phases_once(fake):
    run = read_run(fake)
    add_costs(run, fake.folder, 5.0, 100.0)
    assert run.results["seconds_total"] == 12 + 300 + 170 + 140 + 80 + 5
    names = [stage["name"] for stage in run.results["stages"]]
    assert names[:3] == ["drone surveys", "survey of a", "survey of b"] and names[-1] == "report"
    note(fake.folder, "report", 900.0, 1.0)  # an earlier one
    add_costs(run, fake.folder, 5.0, 100.0)
    assert run.results["seconds_total"] == 707


def test_figures_of_another_field_are_refused(fake, monkeypatch):
    path = fake.folder / "reconstruction.json"
    save(path, json.loads(path.read_text()) | {"weights": "a"})
    read_run(fake)  # the field itself may be gone
    monkeypatch.setattr(module, "has_model", lambda folder: True)
    monkeypatch.setattr(module, "weights_digest", lambda folder: "b")
    with pytest.raises(UserError, match=r"was measured on another field.*evaluate_reconstruction.py again"):
        read_run(fake)


def test_where_nobody_collected_pictures_the_baseline_has_a_reason(fake):
    path = fake.folder / "localisation.json"
    document = json.loads(path.read_text())
    del document["table1"]["baseline"]
    save(path, document)
    assert set(read_run(fake).reasons) == {"table1.layout_0.baseline"}
