"""The report of a run: `report.html`, one self-contained page, and `report.json`, the same figures for programs.

`results` are nested mappings with the keys of REQUIRED_KEYS and whatever else the sections show; `figures` maps names
of panels to PNG bytes; `not_run` maps a key, or the parent of several keys, to the reason why there is no value. A
required key without a value and without a reason is an error, so that nothing goes missing in silence. Numbers that are
not finite become null in the JSON, which is strict. Both files are written beside their place and renamed, so that a
reader never sees half a report.
"""

import base64
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from carff.report_sections import SECTIONS
from carff.report_tables import number
from carff.targets import Verdict, derived, judge, lookup, reason_for
from hashnerf.errors import UserError
from hashnerf.transforms_json import write_atomically

REQUIRED_KEYS = (
    "seconds_total",
    "decision_ms_n10",
    "pcvae.psnr_train_db",
    "pcvae.svm_all",
    "pcvae.svm_ceiling",
    "pcvae.svm_visible",
    "pcvae.svm_visible_heldout",
    "nerf.psnr_matched_db",
    "nerf.psnr_matched_heldout_db",
    "nerf.psnr_unmatched_db",
    "nerf.changed_px_db",
    "nerf.state_identified",
    "forecast.branch_ece",
    "probe.accuracy",
    *(
        f"plan.{rule}.n{draws}.{side}_success"
        for rule in ("risk", "paper")
        for draws in (2, 10, 35)
        for side in ("hazard", "clear")
    ),
    "closed_loop.risk.collisions",
    "closed_loop.risk.needless_stop_rate",
)
PANEL_NAMES = frozenset(panel.name for section in SECTIONS for panel in section.panels)


@dataclass(frozen=True)
class RunInfo:
    """What the header of a report says about the run."""

    name: str
    preset: str
    scenario: str
    command: str
    machine: str
    date: str
    commit: str
    seed: int
    versions: str
    """Interpreter and main libraries, such as `Python 3.11, torch 2.13`."""


def write_report(
    folder: Path,
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
    foreign = sorted(set(figures) - PANEL_NAMES)
    if foreign:
        raise ValueError(f"no section shows the figures {', '.join(foreign)}; the report knows {sorted(PANEL_NAMES)}")
    missing = [key for key in REQUIRED_KEYS if lookup(results, key) is None and not reason_for(key, reasons)]
    if missing:
        raise UserError(
            f"report: no value for {', '.join(missing)}; measure it, or say in `not_run` why it cannot be measured"
        )
    results = derived(_python(results))
    verdicts = judge(results, run.preset, reasons)
    document = _finite({"run": asdict(run), **results, "targets": _target_rows(verdicts), "not_run": reasons})
    text = json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False)
    page = _page(run, results, figures, reasons, verdicts)
    write_atomically(folder / "report.json", f"{text}\n".encode())
    write_atomically(folder / "report.html", page.encode())
    return folder / "report.html"


def _page(
    run: RunInfo, results: Mapping, figures: Mapping[str, bytes], reasons: Mapping[str, str], verdicts: list[Verdict]
) -> str:
    environment = Environment(loader=PackageLoader("carff"), autoescape=True, undefined=StrictUndefined)
    environment.trim_blocks = environment.lstrip_blocks = True
    judged = [verdict for verdict in verdicts if verdict.met is not None]
    return environment.get_template("report.html.j2").render(
        run=run,
        summary=[_summary_row(verdict) for verdict in verdicts],
        met=sum(verdict.met for verdict in judged),
        judged=len(judged),
        sections=[(section, section.tables(results)) for section in SECTIONS],
        pictures={name: base64.b64encode(data).decode("ascii") for name, data in figures.items()},
        why={panel.name: _why(panel, reasons) for section in SECTIONS for panel in section.panels},
    )


def _why(panel, reasons: Mapping[str, str]) -> str:
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
    value = number(verdict.measured, verdict.target.unit)
    return f"{value} ({verdict.reason})" if verdict.reason else value


def _plain(text: str) -> str:
    """A limit as people write it: `97 %`, not `97.0 %`."""
    return text.replace(".0 ", " ")


def _target_rows(verdicts: list[Verdict]) -> list[dict]:
    return [
        {
            "key": verdict.target.key,
            "label": verdict.target.label,
            "comparison": verdict.target.comparison,
            "target": verdict.limit,
            "measured": verdict.measured,
            "met": verdict.met,
            "reason": verdict.reason,
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
    return None if isinstance(value, float) and not math.isfinite(value) else value
