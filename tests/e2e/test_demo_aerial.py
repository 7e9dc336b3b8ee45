"""`demo_aerial.py`, small: from nothing to a report with every required figure."""

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TINY = """
name: tiny
seeds: 1
reconstruction:
  steps: 6
  save_every: 3
  fit: {rays: 128, batch_samples: 4000, occupancy_every: 4}
  field: {levels: 4, log2_table_size: 12, finest_resolution: 64, hidden_width: 16}
  occupancy: {cell: 0.3}
  march: {candidates: 32}
camera: {width: 32, height: 18}
imitation: {views: 6, task: {epochs: 1}}
localisation: {task: {epochs: 1}}
teleoperation: {laps: 1, field_steps: 5, views: 4}
drive: {laps: 1}
evaluation: {layouts: 1, layout_steps: 5, ablation_steps: 5}
"""


def test_from_nothing_to_a_report(tmp_path):
    config = tmp_path / "tiny.yaml"
    config.write_text(f"{TINY}\nruns: {tmp_path / 'runs'}\ndataset: {tmp_path / 'city'}\n")
    done = subprocess.run(
        [sys.executable, "scripts/demo_aerial.py", "--config", str(config)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        timeout=900,
    )
    output = done.stdout + done.stderr
    assert done.returncode == 0 and "Traceback" not in output, output
    run = tmp_path / "runs" / "tiny"
    report = json.loads((run / "report.json").read_text())
    assert report["seconds_total"] > 0 and report["nerf"]["aerial_heldout_psnr_db"] > 5
    for variant in ("none", "colour", "colour_depth", "full"):
        assert report["ground"]["psnr_db"][variant] > 5 and report["ground"]["road_depth_rmse_m"][variant] > 0
    assert set(report["table1"]["layout_0"]) == {"baseline", "ours", "ours_imu"}
    assert set(report["table2"]) == {"outer_loop", "left_turns", "right_turns"}
    for rows in report["table2"].values():
        assert {"imit", "imit_gv", "ours", "ours_gv"} <= set(rows)
    assert report["policy"]["latency_ms_1thread"] > 0 and (run / "report.html").stat().st_size > 10_000
