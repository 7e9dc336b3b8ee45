"""The results page of CARFF: the judged figures of one or more reports side by side, with what produced them."""

from collections.abc import Sequence
from pathlib import Path

from carff.targets import TARGETS
from hashnerf.results_page import copy_reports, provenance, read_reports, target_table
from hashnerf.transforms_json import write_atomically

SCRIPT = "scripts/evaluate_carff.py"
INTRODUCTION = """# Results

Written by `python scripts/publish_results.py --runs '[RUN, ...]'` from the `report.json` of finished runs; nothing here
is typed by hand. A target that was missed says so. The full reports hold the figures, intervals and pictures. What was
tried and what limits the figures: [notes.md](notes.md).

aerial2ground: [its figures](aerial2ground.md), [what limits them](aerial2ground_notes.md), [poses that are
wrong](pose_noise.md), [what a localiser needs](localisation.md), [what the road prior is worth](road_prior.md),
[real recordings](real_data.md), [the bridge to a car](bridge.md). The core: [speed against
accuracy](speed_accuracy.md), [capacity from the pictures](capacity.md), [real photographs](photographs.md),
[budgets](budgets.md), [where the time goes](profile.md), [the numbered rows](numerics.md) and [what they
notice](planted_faults.md), [what was tried](core_notes.md).
"""


def publish(runs: Sequence[Path], out: Path) -> Path:
    """Writes README.md and a copy of every report.json into `out`; raises UserError for a run without a report."""
    reports = read_reports(runs, SCRIPT)
    copy_reports(runs, out)
    text = "\n".join([INTRODUCTION, *target_table(reports, TARGETS, SCRIPT), "", *provenance(reports)])
    write_atomically(out / "README.md", f"{text}\n".encode())
    return out / "README.md"
