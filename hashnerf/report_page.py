"""The report of a run: `report.html`, one self-contained page, and `report.json`, the same figures for programs.

A system says once what its reports tell (a `ReportKind`); a run brings `results`, nested mappings with the required
keys and whatever else the sections show; `figures`, names of panels to PNG bytes; and `not_run`, which maps a key, or
the parent of several keys, to the reason why there is no value. A required key without a value and without a reason is
an error, so that nothing goes missing in silence. Numbers that are not finite become null in the JSON, which is strict.
Both files are written beside their place and renamed, so that a reader never sees half a report.
"""

import base64
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from hashnerf.errors import UserError
from hashnerf.report_tables import Table, number, number_beside
from hashnerf.run_info import RunInfo
from hashnerf.targets import Verdict, lookup, reason_for
from hashnerf.transforms_json import read_transforms, write_atomically

NOT_FINITE = "not finite"
"""The reason of a target whose figure was measured and is NaN or infinite; as JSON has neither, its value is null."""


@dataclass(frozen=True)
class Panel:
    """A figure of the report with its caption."""

    name: str
    title: str
    caption: str
    depends: str
    """Key of the result that the figure shows: where that was not run, its reason explains the empty place."""
    half: bool = False
    """Whether two such figures stand side by side on a wide screen."""


@dataclass(frozen=True)
class Section:
    """A part of the report with its anchor in the navigation."""

    anchor: str
    title: str
    intro: str
    panels: tuple[Panel, ...]
    tables: Callable[[Mapping], list[Table]]


@dataclass(frozen=True)
class ReportKind:
    """What the reports of one system tell."""

    title: str
    """Such as `CARFF report`: above the run's name, and in the title of the page."""
    sections: tuple[Section, ...]
    required_keys: Callable[[Mapping], Sequence[str]]
    """Given the results: the keys that must have a value or a reason."""
    derived: Callable[[Mapping], dict]
    """The results with the figures that follow from others."""
    judge: Callable[[Mapping, str, Mapping[str, str]], list[Verdict]]
    """Given derived results, preset and reasons: every target beside its measurement."""
    intro: str = ""
    """A paragraph above the summary."""
    footnote: str = ""
    """A sentence at the end of the page."""

    @property
    def panels(self) -> tuple[Panel, ...]:
        """The panels of all sections."""
        return tuple(panel for section in self.sections for panel in section.panels)


def write_report(
    folder: Path,
    kind: ReportKind,
    run: RunInfo,
    results: Mapping,
    figures: Mapping[str, bytes],
    not_run: Mapping[str, str] | None = None,
) -> Path:
    """Writes report.html and report.json into `folder` and returns the page's path.

    Raises UserError naming required keys that have neither a value nor a reason, ValueError for figures no section
    shows.
    """
    reasons = dict(not_run or {})
    known = {panel.name for panel in kind.panels}
    foreign = sorted(set(figures) - known)
    if foreign:
        raise ValueError(f"no section shows the figures {', '.join(foreign)}; the report knows {sorted(known)}")
    required = kind.required_keys(results)
    missing = [key for key in required if lookup(results, key) is None and not reason_for(key, reasons)]
    if missing:
        raise UserError(
            f"report: no value for {', '.join(missing)}; measure it, or say in `not_run` why it cannot be measured"
        )
    results = kind.derived(_python(results))
    verdicts = kind.judge(results, run.preset, reasons)
    document = _finite({"run": asdict(run), **results, "targets": _target_rows(verdicts), "not_run": reasons})
    text = json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False)
    page = _page(kind, run, results, figures, reasons, verdicts)
    write_atomically(folder / "report.json", f"{text}\n".encode())
    write_atomically(folder / "report.html", page.encode())
    return folder / "report.html"


def print_targets(folder: Path) -> None:
    """Prints the figures of a written report that have targets.

    Raises UserError, after the last line, naming those that were measured but are not finite: such a run has failed.
    """
    rows = read_transforms(folder / "report.json")["targets"]
    for row in rows:
        missing = NOT_FINITE if row["reason"] == NOT_FINITE else "not run"
        value = missing if row["measured"] is None else f"{row['measured']:.4g}"
        verdict = {True: "met", False: "missed", None: ""}[row["met"]]
        print(f"{row['key']:34s}{value:>10s}  {verdict}")
    bad = [row["key"] for row in rows if row["reason"] == NOT_FINITE]
    if bad:
        raise UserError(f"{folder}: {', '.join(bad)} not finite; a stage has broken down, train it again")


def _page(
    kind: ReportKind,
    run: RunInfo,
    results: Mapping,
    figures: Mapping[str, bytes],
    reasons: Mapping[str, str],
    verdicts: list[Verdict],
) -> str:
    environment = Environment(loader=PackageLoader("hashnerf"), autoescape=True, undefined=StrictUndefined)
    environment.trim_blocks = environment.lstrip_blocks = True
    judged = [verdict for verdict in verdicts if verdict.met is not None]
    return environment.get_template("report.html.j2").render(
        kind=kind,
        run=run,
        summary=[_summary_row(verdict) for verdict in verdicts],
        met=sum(verdict.met for verdict in judged),
        judged=len(judged),
        sections=[(section, section.tables(results)) for section in kind.sections],
        pictures={name: base64.b64encode(data).decode("ascii") for name, data in figures.items()},
        why={panel.name: _why(panel, reasons) for panel in kind.panels},
    )


def _why(panel: Panel, reasons: Mapping[str, str]) -> str:
    return reasons.get(panel.name) or reason_for(panel.depends, reasons) or "this figure was not drawn"


def _summary_row(verdict: Verdict) -> dict[str, str]:
    target, unit = verdict.target, verdict.target.unit
    sign = {">=": "≥", "<=": "≤", "==": "="}[target.comparison]
    return {
        "key": target.key,
        "label": target.label,
        "target": "–" if verdict.limit is None else f"{sign} {_plain(number(verdict.limit, unit))}",
        "measured": _measured(verdict),
        "status": {True: "met", False: "missed", None: "not judged" if verdict.measured is not None else "not run"}[
            verdict.met
        ],
        "paper": target.paper,
    }


def _measured(verdict: Verdict) -> str:
    if verdict.measured is None:
        return f"not run: {verdict.reason}"
    value = number_beside(verdict.measured, verdict.limit, verdict.target.unit)
    return f"{value} ({verdict.reason})" if verdict.reason else value


def _plain(text: str) -> str:
    """A limit as people write it: `97 %`, not `97.0 %`; `0.02 m`, not `0.020 m`."""
    value, _, unit = text.partition(" ")
    return f"{value.rstrip('0').rstrip('.')} {unit}" if unit and "." in value else text


def _target_rows(verdicts: list[Verdict]) -> list[dict]:
    return [
        {
            "key": verdict.target.key,
            "label": verdict.target.label,
            "comparison": verdict.target.comparison,
            "target": verdict.limit,
            "measured": verdict.measured,
            "met": verdict.met,
            "reason": verdict.reason if _is_finite(verdict.measured) else NOT_FINITE,
        }
        for verdict in verdicts
    ]


def _python(value: Any) -> Any:
    """The value in Python's own types: numpy scalars and arrays unpacked, keys as text."""
    if isinstance(value, Mapping):
        return {str(key): _python(item) for key, item in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    return [_python(item) for item in value] if isinstance(value, (list, tuple)) else value


def _finite(value: Any) -> Any:
    """The value with None in the place of every number that JSON cannot hold."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return value if _is_finite(value) else None


def _is_finite(value: Any) -> bool:
    return not isinstance(value, float) or math.isfinite(value)
