"""Whole reports of made-up runs: everything there, parts missing, required figures without value or reason."""

import json
import re
from dataclasses import replace

import pytest

from aerial2ground import report
from aerial2ground.car_camera import CarCameraConfig
from aerial2ground.config import AerialConfig
from aerial2ground.report import write_run_report
from aerial2ground.report_sections import SECTIONS
from aerial2ground.targets import required_keys
from hashnerf.errors import UserError
from hashnerf.targets import lookup
from tests.aerial2ground.fake_run import HEIGHT, PATHS, WIDTH, fake_run

TOWNS = ("layout_0", "layout_1", "layout_2")


@pytest.fixture
def fake(tmp_path) -> AerialConfig:
    """A finished run without its data set."""
    camera = CarCameraConfig(width=WIDTH, height=HEIGHT)
    config = AerialConfig(
        name="fake", runs=str(tmp_path / "runs"), dataset=str(tmp_path / "moved" / "town"), camera=camera
    )
    fake_run(config)
    return config


@pytest.fixture
def without_figures(monkeypatch) -> None:
    """Leaves the figures out, which take most of the time."""
    monkeypatch.setattr(report, "draw_figures", lambda run, config, network: {})


def strict(config: AerialConfig) -> dict:
    """The report's figures; fails for a token that is not JSON."""

    def refuse(token: str):
        raise AssertionError(f"{token} is not JSON")

    return json.loads((config.folder / "report.json").read_text(), parse_constant=refuse)


def edit(path, change) -> None:
    """Changes a JSON file in place."""
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def test_a_finished_run_shows_every_panel_and_holds_every_key(fake):
    page = write_run_report(fake, "python x.py --name 'a b'").read_text()
    document = strict(fake)
    assert document["not_run"] == {} and "Not run" not in page
    assert all(lookup(document, key) is not None for key in required_keys(list(PATHS), TOWNS))
    panels = [panel.name for section in SECTIONS for panel in section.panels]
    assert all(f'id="figure-{name}"' in page for name in panels)
    assert len(re.findall(r'src="data:image/png;base64,', page)) == len(panels)
    assert "http:" not in page and "https:" not in page and "<script" not in page
    assert "python x.py --name &#39;a b&#39;" in page and document["run"]["scenario"] == "town"
    # 12 + 300 + 170 + 140 + 80 s of stages and phases; the two surveys ran within their phase.
    assert 702 <= document["seconds_total"] < 1000 and document["seconds_cover"] == "whole run"
    assert document["nerf"] == {
        "aerial_heldout_psnr_db": 26.2,
        "aerial_heldout_psnr_as_told_db": 22.9,
        "test_pictures": 12,
        "seconds": 190.0,
    }
    assert document["ground"]["psnr_db"]["none"] == pytest.approx(18.2)
    assert document["table2"]["left_turns"]["ours"]["runs"] == 2


def test_the_map_has_roads_where_the_data_set_is(fake, survey_folder):
    config = replace(fake, dataset=str(survey_folder))
    write_run_report(config)
    assert strict(config)["run"]["scenario"] == "mini_city"


def test_parts_that_are_missing_are_named(fake):
    for name in ("ablation/none/reconstruction.json", "latency.json", "survey.png", "timings.json"):
        (fake.folder / name).unlink()
    other = fake.folder.parent / "fake_layout_1" / "localisation.json"
    other.unlink()
    page = write_run_report(fake).read_text()
    reasons = strict(fake)["not_run"]
    assert "(none)" in reasons["ground.psnr_db.none"] and "(none)" in reasons["ground.road_depth_rmse_m.none"]
    assert reasons["policy"] == "the run holds no latency.json"
    assert reasons["table1.layout_1"] == "the run holds no localisation.json"
    assert "scripts/demo_aerial.py" in reasons["seconds_total"]
    assert "Not run: this figure was not drawn" in page and "layout 2, Ours" in page and "layout 1, Ours" not in page


def test_a_run_without_truth_reports_what_pictures_alone_can_tell(fake):
    for folder in (fake.folder, *(fake.folder / "ablation").iterdir()):
        edit(folder / "reconstruction.json", lambda document: [document.pop(k, None) for k in ("ground", "poses")])
    (fake.folder / "driving.json").unlink()
    write_run_report(fake)
    reasons = strict(fake)["not_run"]
    assert "no embedded world" in reasons["ground.psnr_db.full"] and "no embedded world" in reasons["ground.main"]
    assert reasons["table2"] == "the run holds no driving.json"
    order = next(row for row in strict(fake)["targets"] if row["key"] == "table2_order.pos_m")
    assert order["measured"] is None and order["reason"] == "the run holds no driving.json"


def test_networks_that_drove_nowhere_have_a_reason_and_ones_that_are_missing_somewhere_none(fake, without_figures):
    def only_ours(document):
        for rows in document["table2"].values():
            for name in ("imit", "imit_gv", "ours_gv"):
                del rows[name]

    def without_one(document):
        del document["table2"]["left_turns"]["imit_gv"]

    saved = (fake.folder / "driving.json").read_text()
    edit(fake.folder / "driving.json", only_ours)
    write_run_report(fake)
    assert "collected from the ground" in strict(fake)["not_run"]["table2.left_turns.imit_gv"]
    (fake.folder / "driving.json").write_text(saved)
    edit(fake.folder / "driving.json", without_one)
    with pytest.raises(UserError, match=r"no value for table2.left_turns.imit_gv.pos_m"):
        write_run_report(fake)


def test_a_required_figure_without_a_value_is_an_error_unless_its_file_says_why(fake, without_figures):
    path = fake.folder / "localisation.json"
    edit(path, lambda document: document["table1"].pop("ours_imu"))
    with pytest.raises(UserError, match=r"table1.layout_0.ours_imu.pos_m, table1.layout_0.ours_imu.yaw_deg"):
        write_run_report(fake)
    assert not (fake.folder / "report.json").exists()
    edit(path, lambda document: document.update(not_run={"ours_imu": "the car has no inertial sensor"}))
    write_run_report(fake)
    assert strict(fake)["not_run"] == {"table1.layout_0.ours_imu": "the car has no inertial sensor"}


def test_without_reconstruction_there_is_no_report(fake):
    (fake.folder / "reconstruction.json").unlink()
    with pytest.raises(UserError, match=r"run scripts/evaluate_reconstruction.py first"):
        write_run_report(fake)


def test_a_part_of_the_run_is_not_judged_as_a_whole(fake, without_figures):
    edit(fake.folder / "timings.json", lambda document: document["stages"].pop("radiance fields"))
    write_run_report(fake)
    row = next(row for row in strict(fake)["targets"] if row["key"] == "seconds_total")
    assert (row["met"], row["reason"]) == (None, "without radiance fields")


def test_pictures_of_another_grid_and_numbers_that_are_not_there(fake):
    config = replace(fake, camera=CarCameraConfig(width=31, height=17))
    edit(fake.folder / "reconstruction.json", lambda document: document["ground"].update(hidden_road_psnr_db=None))
    page = write_run_report(config).read_text()
    assert strict(fake)["ground"]["main"]["hidden_road_psnr_db"] is None
    assert 'id="figure-prior_views"' in page
