"""Running a sweep: every row is trained and measured in a folder of its own, and its result kept there.

<runs>/<sweep>/<row>/result.json: {row, settings, commands, reason, machine, commit, date, figures}; `reason` says why a
row failed.
A row whose result was made by the same commands is not run again; a failed one is tried again by the next call.
"""

import json
import shutil
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from hashnerf.errors import UserError
from hashnerf.pipeline import LOGS, TIMINGS, log_of, read_timings, run_stage
from hashnerf.report_tables import number
from hashnerf.run_info import commit, machine
from hashnerf.sweep import MEMORY, TIME, Figure, Row, Sweep
from hashnerf.transforms_json import read_transforms, write_atomically

RESULT, SHARED = "result.json", "shared"
STOPPED = (130, 143)
"""Statuses of a stage that was told to stop (Ctrl-C, kill): that ends the sweep, it is no failure of the row."""


@dataclass(frozen=True)
class Result:
    """What became of a row."""

    row: Row
    figures: Mapping[str, float]
    """Empty where the row failed."""
    reason: str = ""
    machine: str = ""
    commit: str = ""
    date: str = ""


def run_sweep(
    sweep: Sweep, runs: Path, scripts: Path, workers: int = 1, say: Callable[[str], None] = print, most: int = 0
) -> list[Result]:
    """Runs the rows that have no result yet, `workers` side by side, and returns all results in order.

    `most` ends the sweep after so many rows of the list (0: all). Raises UserError where the shared run fails.
    """
    folder = runs / sweep.name
    shared = _shared_run(sweep, runs / SHARED, scripts, say)
    rows = sweep.rows()[: most or None]

    def run(place: tuple[int, Row]) -> Result:
        number, row = place
        commands = sweep.commands(row, folder, scripts)
        found = read_result(folder / row.name, row, commands)
        if found is not None and found.figures.keys() >= sweep.figures.keys():
            return found
        say(f"{sweep.name} {number + 1}/{len(rows)}: {row.name}")
        result = _measured(sweep, row, folder / row.name, commands, shared)
        say(f"{sweep.name} {number + 1}/{len(rows)}: {row.name}: {_summary(sweep, result)}")
        return result

    with ThreadPoolExecutor(max(workers, 1)) as pool:
        try:
            return list(pool.map(run, enumerate(rows)))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def finished_rows(sweep: Sweep, runs: Path, scripts: Path) -> list[Result]:
    """Returns the rows of a sweep that were run by the commands of today, failed ones too."""
    folder = runs / sweep.name
    found = [read_result(folder / row.name, row, sweep.commands(row, folder, scripts)) for row in sweep.rows()]
    return [one for one in found if one is not None and (one.reason or one.figures.keys() >= sweep.figures.keys())]


def read_result(folder: Path, row: Row, commands: Mapping[str, list[str]]) -> Result | None:
    """Returns what a row's folder holds; None where nothing was measured or other commands did."""
    path = folder / RESULT
    if not path.is_file():
        return None
    found = read_transforms(path)
    if found.get("commands") != _recorded(commands):
        return None
    about = {key: found.get(key, "") for key in ("machine", "commit", "date", "reason")}
    return Result(row, found.get("figures", {}), **about)


def figure_of(folder: Path, figure: Figure) -> float:
    """Reads a figure from the file of a run; raises UserError naming file and key where there is no number."""
    path = folder / figure.file
    if not path.is_file():
        raise UserError(f"{figure.file}: no stage wrote this file; name another in the figure")
    found: list = [read_transforms(path)]
    for step in figure.key.split("."):
        inside = [one for one in found if isinstance(one, Mapping)]
        found = [value for one in inside for name, value in one.items() if step in ("*", name)]
    numbers = [value for value in found if isinstance(value, int | float) and not isinstance(value, bool)]
    if not numbers or len(numbers) < len(found):
        raise UserError(f"{figure.file}: holds no number at {figure.key}")
    return float(np.mean(numbers))


def _measured(sweep: Sweep, row: Row, folder: Path, commands: Mapping[str, list[str]], shared: Path | None) -> Result:
    """Trains and measures one row from its start, as a continued one would not have its whole time.

    What goes wrong in it becomes its reason.
    """
    if folder.is_dir():
        shutil.rmtree(folder)
    if shared is not None:
        _copy_run(shared, folder)
    figures, reason = {}, ""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for stage, command in commands.items():
            _run(stage, command, folder)
        figures = _figures(sweep, folder)
    except UserError as error:
        reason = str(error)
    date = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z")
    where = {"machine": machine(), "commit": commit(), "date": date}
    about = {"row": row.name, "settings": row.settings, "commands": _recorded(commands), "reason": reason, **where}
    _write(folder / RESULT, about | {"figures": figures})
    return Result(row, figures, reason, **where)


def _run(stage: str, command: list[str], folder: Path) -> None:
    """Runs one stage; a failure becomes a UserError with the last line that it printed."""
    try:
        run_stage(stage, command, folder, quiet=True)
    except SystemExit as end:
        if end.code in STOPPED:
            raise
        text = log_of(folder, stage).read_text(encoding="utf-8", errors="replace").strip()
        last = text.splitlines()[-1].strip() if text else "it printed nothing"
        raise UserError(f"{stage} ended with status {end.code}: {last}") from end


def _figures(sweep: Sweep, folder: Path) -> dict[str, float]:
    timings = read_timings(folder)
    own = [timings[stage] for stage in sweep.timed]
    peak = max((one["peak_memory_mb"] for one in own), default=0.0)
    figures = {TIME: sum(one["processor_seconds"] for one in own), MEMORY: peak}
    return figures | {name: figure_of(folder, figure) for name, figure in sweep.figures.items() if figure.file}


def _shared_run(sweep: Sweep, runs: Path, scripts: Path, say: Callable[[str], None]) -> Path | None:
    """Makes the run that rows start from, unless the same commands have made it; sweeps may name the same."""
    if sweep.shared is None:
        return None
    folder, commands = runs / sweep.shared.name, sweep.shared_commands(runs, scripts)
    path, recorded = folder / RESULT, {"commands": _recorded(commands)}
    if folder.is_dir() and (not path.is_file() or read_transforms(path) != recorded):
        shutil.rmtree(folder)  # other commands made it
    folder.mkdir(parents=True, exist_ok=True)
    _write(path, recorded)
    for stage, command in commands.items():
        if stage not in read_timings(folder):
            say(f"{sweep.name}, run {sweep.shared.name} for all rows: {stage}")
            _run(stage, command, folder)
    return folder


def _recorded(commands: Mapping[str, list[str]]) -> dict[str, list[str]]:
    """Returns commands without the place of the scripts: a moved checkout keeps its results."""
    return {stage: [Path(command[0]).name, *command[1:]] for stage, command in commands.items()}


def _copy_run(shared: Path, folder: Path) -> None:
    """Copies a run without its times, logs and result."""
    shutil.copytree(shared, folder, symlinks=True, ignore=shutil.ignore_patterns(TIMINGS, RESULT, LOGS, ".lock"))


def _write(path: Path, document: dict) -> None:
    write_atomically(path, json.dumps(document, indent=1, allow_nan=False).encode())


def _summary(sweep: Sweep, result: Result) -> str:
    if result.reason:
        return f"failed: {result.reason}"
    shown = dict.fromkeys((TIME, sweep.cost, sweep.accuracy))
    return ", ".join(f"{name} {number(result.figures[name], sweep.figures[name].unit, 2)}" for name in shown)
