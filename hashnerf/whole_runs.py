"""Presets of whole pipelines beside each other: what their published reports say of time and of what they reach.

The YAML file: {pipeline: {reports: {preset: report.json}, figures: {name: {key, unit, better: more | less}}}}.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hashnerf.command_line import read_yaml
from hashnerf.errors import UserError
from hashnerf.pareto import dominated
from hashnerf.report_tables import number
from hashnerf.results_page import markdown_table
from hashnerf.targets import lookup
from hashnerf.transforms_json import read_transforms

SECONDS = "seconds_total"


def whole_runs_section(path: Path) -> str:
    """Returns Markdown: a table for every pipeline and whether a preset is dominated in time and all its figures.

    Raises UserError for a report that is missing or lacks a figure.
    """
    parts = ["## Presets of whole runs", "Time and figures as their own reports give them, machines included."]
    for pipeline, about in read_yaml(path).items():
        parts += _pipeline(pipeline, about)
    return "\n\n".join(parts)


def _pipeline(pipeline: str, about: Mapping) -> list[str]:
    figures = about["figures"]
    rows = [["preset", "time", *figures, "machine", "commit"]]
    losses = []
    for preset, file in about["reports"].items():
        report = read_transforms(Path(file))
        keys = {SECONDS: SECONDS, **{name: figure["key"] for name, figure in figures.items()}}
        values = {name: lookup(report, key) for name, key in keys.items()}
        missing = [keys[name] for name, value in values.items() if value is None]
        if missing:
            raise UserError(f"{file}: lacks {', '.join(missing)}; publish the report again")
        signs = [-1 if figure["better"] == "more" else 1 for figure in figures.values()]
        losses.append([values[SECONDS], *(sign * values[name] for sign, name in zip(signs, figures))])
        cells = [number(values[name], figure.get("unit", "")) for name, figure in figures.items()]
        run = report["run"]
        rows.append([preset, number(values[SECONDS], "min"), *cells, run["machine"], run["commit"]])
    beaten = [preset for preset, worse in zip(about["reports"], dominated(np.array(losses, dtype=float))) if worse]
    verdict = f"Dominated: {', '.join(beaten)}." if beaten else "None dominates another."
    return [f"**{pipeline}**", markdown_table(rows), verdict]
