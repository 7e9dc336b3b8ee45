"""Pages of results in Markdown: the judged figures of one or more reports side by side, with what produced them."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from hashnerf.errors import UserError
from hashnerf.report_page import NOT_FINITE
from hashnerf.report_tables import Table, number, number_beside
from hashnerf.targets import Target, lookup
from hashnerf.transforms_json import read_transforms

PROVENANCE = ("name", "scenario", "preset", "command", "machine", "date", "commit", "seed", "versions")


def read_reports(runs: Sequence[Path], script: str) -> list[dict]:
    """Returns the report.json of every run folder.

    Raises UserError, which names the `script` that writes such reports, for a run without one, for no run at all and
    for two folders of one name, whose copies would be one file.
    """
    twice = [run for number, run in enumerate(runs) if run.name in [other.name for other in runs[:number]]]
    if twice:
        raise UserError(f"runs: {twice[0]} and another run folder have the same name; rename one of them")
    reports = [_report(run, script) for run in runs]
    if not reports:
        raise UserError("runs: name at least one run folder that holds a report.json")
    return reports


def copy_reports(runs: Sequence[Path], out: Path) -> None:
    """Copies every report.json to `<out>/<run>.json`."""
    out.mkdir(parents=True, exist_ok=True)
    for run in runs:
        shutil.copyfile(run / "report.json", out / f"{run.name}.json")


def markdown_table(rows: Sequence[Sequence[str]]) -> str:
    """Returns rows of cells, the first of them the head, as a Markdown table."""
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])


def target_table(reports: Sequence[dict], targets: Sequence[Target], script: str) -> list[str]:
    """Returns the lines of a table of all targets, one column a report; raises UserError where a report lacks one."""
    names = [report["run"]["name"] for report in reports]
    lines = [f"| figure | {' | '.join(names)} |", f"|---|{'---|' * len(names)}"]
    for target in targets:
        cells = [_cell(report, target.key, target.unit, script) for report in reports]
        lines.append(f"| {target.label} (`{target.key}`) | {' | '.join(cells)} |")
    return lines


def provenance(reports: Sequence[dict]) -> list[str]:
    """Returns the lines of a table of what produced the reports."""
    header = ("run", *PROVENANCE[1:])
    lines = [f"| {' | '.join(header)} |", f"|---|{'---|' * (len(header) - 1)}"]
    return lines + [f"| {' | '.join(str(report['run'][key]) for key in PROVENANCE)} |" for report in reports]


def table_lines(table: Table) -> list[str]:
    """Returns the lines of a report's table, its note below; none for a table without rows."""
    if not table.rows:
        return []
    lines = [f"| {' | '.join(table.header)} |", f"|{'---|' * len(table.header)}"]
    lines += [f"| {' | '.join(row)} |" for row in table.rows]
    return [*lines, "", table.note] if table.note else lines


def _report(run: Path, script: str) -> dict:
    if not (run / "report.json").is_file():
        raise UserError(f"{run}: holds no report.json; run {script} for it first")
    report = read_transforms(run / "report.json")
    if not {"run", "targets"} <= report.keys():
        raise UserError(f"{run / 'report.json'}: is no report of {script}; run that again")
    return report


def _cell(report: dict, key: str, unit: str, script: str) -> str:
    row = next((row for row in report["targets"] if row["key"] == key), None)
    if row is None:
        raise UserError(f"{report['run']['name']}: its report lacks {key}; run {script} again")
    if row["measured"] is None:
        return NOT_FINITE if row.get("reason") == NOT_FINITE else "not run"
    measured = lookup(report, key) if lookup(report, key) is not None else row["measured"]
    value = number_beside(measured, row["target"], unit)
    if row["target"] is None:
        return f"{value} ({row['reason']})" if row.get("reason") else value
    sign = {">=": "≥", "<=": "≤", "==": "="}[row["comparison"]]
    verdict = "met" if row["met"] else "**missed**"
    return f"{value} ({verdict}, target {sign} {number(row['target'], unit)})"
