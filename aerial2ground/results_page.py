"""The results page of aerial2ground: judged figures, Tables I and II and the road prior of one or more reports."""

from collections.abc import Sequence
from pathlib import Path

from aerial2ground.report_tables import ground_tables, policy_tables, table_one, table_two
from aerial2ground.targets import TARGETS
from hashnerf.results_page import copy_reports, provenance, read_reports, table_lines, target_table
from hashnerf.transforms_json import write_atomically

PAGE = "aerial2ground.md"
SCRIPT = "scripts/report_aerial.py"
INTRODUCTION = """# aerial2ground: results

Written by `python scripts/publish_aerial_results.py --runs '[RUN, ...]'` from the `report.json` of finished runs;
nothing here is typed by hand, except the paper's own figures, which stand beside ours. A target that was missed says
so. The full reports hold the figures and pictures.
"""
TABLES = (
    ("Table I: where is the car?", table_one),
    ("Table II: driving by pictures", table_two),
    ("Views from the ground, and what the road prior adds", ground_tables),
    ("Time of one decision", policy_tables),
)


def publish(runs: Sequence[Path], out: Path) -> Path:
    """Writes aerial2ground.md and a copy of every report.json into `out`; raises UserError for runs without one."""
    reports = read_reports(runs, SCRIPT)
    lines = [INTRODUCTION, *target_table(reports, TARGETS, SCRIPT)]
    for report in reports:
        lines += ["", f"## {report['run']['name']}", *_tables(report)]
    lines += ["", "## What produced this", "", *_with_seconds(reports)]
    copy_reports(runs, out)
    write_atomically(out / PAGE, ("\n".join(lines) + "\n").encode())
    return out / PAGE


def _tables(report: dict) -> list[str]:
    lines: list[str] = []
    for title, build in TABLES:
        for table in build(report):
            lines += ["", f"### {title}", "", *table_lines(table)]
    if report.get("not_run"):
        lines += ["", "### Not run", "", *(f"* `{key}`: {reason}" for key, reason in report["not_run"].items())]
    return lines


def _with_seconds(reports: Sequence[dict]) -> list[str]:
    """The table of what produced the reports, with the seconds of the whole run."""
    header, rule, *rows = provenance(reports)
    seconds = [report.get("seconds_total") for report in reports]
    texts = ["–" if value is None else f"{value:.0f}" for value in seconds]
    return [f"{header} seconds |", f"{rule}---|", *(f"{row} {text} |" for row, text in zip(rows, texts))]
