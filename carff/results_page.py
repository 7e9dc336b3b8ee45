"""The results page: the judged figures of one or more reports side by side, with what produced them."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from carff.report_tables import number
from carff.targets import TARGETS, lookup
from hashnerf.errors import UserError
from hashnerf.transforms_json import read_transforms, write_atomically

INTRODUCTION = """# Results

Written by `python scripts/publish_results.py --runs '[RUN, ...]'` from the `report.json` of finished runs; nothing here
is typed by hand. A target that was missed says so. The full reports hold the figures, intervals and pictures. What was
tried and what limits the figures: [notes.md](notes.md).
"""


def publish(runs: Sequence[Path], out: Path) -> Path:
    """Writes README.md and a copy of every report.json into `out`; raises UserError for a run without a report."""
    reports = [_report(run) for run in runs]
    if not reports:
        raise UserError("runs: name at least one run folder that holds a report.json")
    out.mkdir(parents=True, exist_ok=True)
    for run in runs:
        shutil.copyfile(run / "report.json", out / f"{run.name}.json")
    text = "\n".join([INTRODUCTION, *_table(reports), "", *_provenance(reports)])
    write_atomically(out / "README.md", f"{text}\n".encode())
    return out / "README.md"


def _report(run: Path) -> dict:
    if not (run / "report.json").is_file():
        raise UserError(f"{run}: holds no report.json; run scripts/evaluate_carff.py for it first")
    report = read_transforms(run / "report.json")
    if not {"run", "targets"} <= report.keys():
        raise UserError(f"{run / 'report.json'}: is no report of scripts/evaluate_carff.py; run that again")
    return report


def _table(reports: Sequence[dict]) -> list[str]:
    names = [report["run"]["name"] for report in reports]
    lines = [f"| figure | {' | '.join(names)} |", f"|---|{'---|' * len(names)}"]
    for target in TARGETS:
        cells = [_cell(report, target.key, target.unit) for report in reports]
        lines.append(f"| {target.label} (`{target.key}`) | {' | '.join(cells)} |")
    return lines


def _cell(report: dict, key: str, unit: str) -> str:
    row = next((row for row in report["targets"] if row["key"] == key), None)
    if row is None:
        raise UserError(f"{report['run']['name']}: its report lacks {key}; run scripts/evaluate_carff.py again")
    if row["measured"] is None:
        return "not run"
    value = number(lookup(report, key) if lookup(report, key) is not None else row["measured"], unit)
    if row["target"] is None:
        return f"{value} ({row['reason']})" if row.get("reason") else value
    sign = {">=": "≥", "<=": "≤", "==": "="}[row["comparison"]]
    verdict = "met" if row["met"] else "**missed**"
    return f"{value} ({verdict}, target {sign} {number(row['target'], unit)})"


def _provenance(reports: Sequence[dict]) -> list[str]:
    lines = ["| run | scenario | preset | command | machine | date | commit | seed | versions |", "|---|" + "---|" * 8]
    for report in reports:
        run = report["run"]
        keys = ("name", "scenario", "preset", "command", "machine", "date", "commit", "seed", "versions")
        lines.append(f"| {' | '.join(str(run[key]) for key in keys)} |")
    return lines
