"""The results page says what was met and what was missed, and by which run."""

import pytest

from aerial2ground.config import AerialConfig
from aerial2ground.report import write_run_report
from aerial2ground.results_page import publish
from hashnerf.errors import UserError
from tests.aerial2ground.fake_run import fake_run


def test_the_page_has_targets_tables_reasons_and_origin(tmp_path):
    config = AerialConfig(name="fake", runs=str(tmp_path / "runs"), dataset=str(tmp_path / "town"))
    fake_run(config)
    (config.folder / "latency.json").unlink()
    write_run_report(config, "python x.py")
    page = publish([config.folder], tmp_path / "out")
    text = page.read_text()
    assert page.name == "aerial2ground.md" and (tmp_path / "out" / "fake.json").is_file()
    line = next(line for line in text.splitlines() if "nerf.aerial_heldout_psnr_db" in line)
    assert "26.2 dB (met, target ≥ 25.0 dB)" in line
    assert "| layout 1, Ours + IMU |" in text and "| left turns, Imit + GV |" in text
    assert "| prior: colour + depth |" in text and "* `policy`: the run holds no latency.json" in text
    assert "python x.py" in text and text.splitlines()[-3].endswith("seconds |")


def test_a_run_without_report_is_a_sentence(tmp_path):
    with pytest.raises(UserError, match=r"run scripts/report_aerial.py for it first"):
        publish([tmp_path], tmp_path / "out")
    assert not (tmp_path / "out").exists()
