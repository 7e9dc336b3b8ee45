"""docs/results/bridge.md: every requirement with its test and its figure, and what scripts/try_bridge.py measured."""

import json
import math
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from hashnerf.errors import UserError
from hashnerf.numeric_rows import Measured, RowsRun, read_run
from hashnerf.results_page import markdown_table

IMAGE = "bridge_drive.png"
"""In docs/images."""
PARTS = ("faults", "laps", "period", "noise", "latency", "chart", "coverage", "mutants")


def run_rows() -> RowsRun:
    """Runs the tests of all requirements, one after the other; raises UserError where pytest itself fails."""
    with tempfile.TemporaryDirectory() as folder:
        options = ["-m", "bridge", f"--junitxml={folder}/tests.xml", "-o", "junit_family=legacy"]
        if subprocess.run([sys.executable, "-m", "pytest", *options], check=False).returncode > 1:
            raise UserError("pytest could not run the requirements; run `python -m pytest -m bridge` to see why")
        return read_run(Path(folder) / "tests.xml", "bridge_row")


def read_parts(folder: Path) -> dict[str, dict]:
    """Returns what every part wrote; raises UserError for one that is not there."""
    parts = {}
    for name in PARTS:
        file = folder / f"{name}.json"
        if not file.is_file():
            script = "scripts/mutate_guard.py" if name == "mutants" else "scripts/try_bridge.py"
            raise UserError(f"{file}: no such file; run {script} first")
        parts[name] = json.loads(file.read_text(encoding="utf-8"))
    return parts


def page(rows: Mapping[str, Mapping], run: RowsRun, parts: Mapping[str, Mapping], about: str) -> str:
    """Returns the page; raises UserError for a requirement that is neither measured nor excused."""
    found = {name: part["found"] for name, part in parts.items() if "found" in part}
    sections = [
        f"# The bridge\n\n{about}",
        "## What it had to show\n\n" + _targets(rows, run, found, parts["mutants"]),
        "## Faults while the car drives\n\n" + _faults(found["faults"]),
        f"![Steering, speed and pictures of a drive](../images/{IMAGE})\n\n" + _chart(found["chart"]),
        "## Hardware in the loop\n\n" + _laps(found["laps"]),
        "## Set-points on the wire\n\n" + _period(found["period"], found["noise"]),
        "## From picture to byte\n\n" + _latency(found["latency"]),
        "## Requirements\n\n" + _requirements(rows, run),
        "## Mutants of the guard\n\n" + _mutants(parts["mutants"], found["coverage"]),
        "## Where the figures come from\n\n" + _sources(parts),
    ]
    return "\n\n".join(sections) + "\n"


def failed(rows: Mapping[str, Mapping], run: RowsRun) -> list[str]:
    """Returns the requirements of which a test failed."""
    return [row for row in rows if any(line.row == row and not _holds(line, run) for line in run.lines)]


def _holds(line: Measured, run: RowsRun) -> bool:
    """A test that ran beside others lets times be longer: here they must be as required."""
    return run.passed[line.test] and line.worst <= line.accepted


def _verdict(met: bool) -> str:
    return "met" if met else "**missed**"


def _targets(rows: Mapping, run: RowsRun, found: Mapping, mutants: Mapping) -> str:
    excused = [row for row in rows if "reason" in rows[row]]
    wrong = failed(rows, run)
    extra = [one["bridge"]["interventions"] - one["simulator"]["interventions"] for one in found["laps"]]
    worst = max(found["period"], key=lambda one: one["p99"])
    late = [one["name"] for one in found["faults"] if not max(one["took"]) <= one["allowed"]]
    noise, policy = found["noise"], found["latency"][1]
    ends = "still running" if noise["alive"] else "ended"
    lines = [
        ("figure", "target", "measured", ""),
        (
            "R01 to R33, X1 to X7",
            "each a passing test, or a reason",
            f"{len(rows) - len(excused)} tested, {len(excused)} excused, failed: {', '.join(wrong) or 'none'}",
            _verdict(not wrong),
        ),
        (
            "interventions with the hardware in the loop, more than in the simulator",
            "at most 1",
            f"{max(extra)} in {found['laps'][0]['bridge']['laps']} laps of each of {len(extra)} trajectories",
            _verdict(max(extra) <= 1),
        ),
        (
            "command period",
            "median 20 ms, p99 <= 30 ms",
            f"{worst['median']:.1f}, {worst['p99']:.1f} ms; {worst['seconds']:g} s, {worst['busy']} busy processes",
            _verdict(abs(worst["median"] - 20) <= 1 and worst["p99"] <= 30),
        ),
        (
            "first brake frame after a fault",
            "as below, each time",
            f"{sum(len(one['took']) for one in found['faults'])} faults, too late: {', '.join(late) or 'none'}",
            _verdict(not late),
        ),
        (
            "noise on the reply path",
            "1e6 bytes: no crash, nothing beyond the limits, no growth",
            f"{noise['sent']} bytes: {ends}, {noise['outside']} frames beyond, {noise['growth']:+.1f} MB",
            _verdict(noise["alive"] and not noise["outside"] and noise["growth"] < 5 and noise["sent"] >= 1e6),
        ),
        (
            "mutants of the guard killed",
            ">= 95 %",
            f"{mutants['killed_share']:.1%} of {mutants['mutants']}",
            _verdict(mutants["killed_share"] >= 0.95),
        ),
        ("picture to command, one thread", "median <= 5 ms", f"{policy[1]:.2f} ms", _verdict(policy[1] <= 5)),
    ]
    return markdown_table(lines)


def _faults(faults: Sequence[Mapping]) -> str:
    lines = [("fault", "allowed, ms", "median, ms", "longest, ms", "times", "too late")]
    for one in faults:
        took, allowed = one["took"], one["allowed"]
        late = sum(not seconds <= allowed for seconds in took)
        figures = (f"{1000 * allowed:.0f}", f"{1000 * statistics.median(took):.0f}", f"{1000 * max(took):.0f}")
        lines.append((one["what"], *figures, str(len(took)), str(late)))
    note = "From the fault to the first brake frame at the controller that no motion frame follows."
    return f"{note}\n\n{markdown_table(lines)}"


def _chart(replayed: str) -> str:
    return (
        "A drive on the rig, drawn from its black box: the wheels are checked, the car drives, the camera freezes, the "
        f"guard slows down and brakes; armed anew, it drives until the emergency stop. Replayed: {replayed}."
    )


def _laps(laps: Sequence[Mapping]) -> str:
    lines = [("trajectory", "laps", "", "interventions", "position, cm", "yaw, degrees")]
    for one in laps:
        for way, name in (("bridge", "serial port and camera stream"), ("simulator", "simulator alone")):
            drive = one[way]
            figures = (f"{100 * drive['position_rmse']:.1f}", f"{drive['yaw_rmse']:.2f}")
            lines.append((one["trajectory"], str(drive["laps"]), name, str(drive["interventions"]), *figures))
    note = (
        "One policy, trained on drone pictures alone, drives a simulated car at 0.8 m/s: through the bytes and the "
        "camera code of a real car, and in the simulator without them. Root mean squares."
    )
    return f"{note}\n\n{markdown_table(lines)}"


def _period(period: Sequence[Mapping], noise: Mapping) -> str:
    lines = [("beside", "seconds", "median, ms", "p99, ms", "longest, ms", "damaged bytes", "stops")]
    for one in period:
        figures = (f"{one[key]:.1f}" for key in ("median", "p99", "longest"))
        beside = f"{one['busy']} busy process{'es' if one['busy'] > 1 else ''}"
        lines.append((beside, f"{one['seconds']:g}", *figures, str(one["damaged"]), str(one["faults"])))
    rates = f"Steepest on the wire: {noise['steering']:.2f} rad/s of steering, {noise['speed']:.2f} m/s^2 of speed."
    return f"{markdown_table(lines)}\n\n{rates}"


def _latency(latency: Sequence[Sequence]) -> str:
    lines = [("from a picture to the bytes that answer it", "median, ms", "p99, ms")]
    return markdown_table([*lines, *((stage, f"{median:.2f}", f"{p99:.2f}") for stage, median, p99 in latency)])


def _requirements(rows: Mapping[str, Mapping], run: RowsRun) -> str:
    silent = sorted({test for test, passed in run.passed.items() if not passed} - {line.test for line in run.lines})
    if silent:
        raise UserError(f"{silent[0]}: failed before it measured anything; run `python -m pytest -m bridge` to see why")
    lines = [("row", "requirement", "done", "measured", "required", "", "test")]
    for row, about in rows.items():
        own = [line for line in run.lines if line.row == row]
        if "reason" in about:
            lines.append((row, about["requirement"], f"not tested: {about['reason']}", "", "", "", ""))
        elif not own:
            raise UserError(f"{row}: no test measures it; write one with the fixture bridge_row, or give a reason")
        for number, line in enumerate(own):
            requirement = about["requirement"] if number == 0 else ""
            figures = (_figure(line.worst, line.unit), _figure(line.accepted, line.unit))
            test = f"`{line.test.removeprefix('tests.aerial2ground.')}`"
            lines.append((row, requirement, line.inputs, *figures, "yes" if _holds(line, run) else "**no**", test))
    return markdown_table(lines)


def _figure(value: float, unit: str) -> str:
    text = "never" if math.isinf(value) else f"{value:.4g}"
    return f"{text} {unit}".strip()


def _mutants(mutants: Mapping, coverage: Mapping) -> str:
    drawn = f" ({mutants['sample']:.0%} of all, drawn at random)" if mutants["sample"] < 1 else ""
    counts = ", ".join(f"{count} {name}" for name, count in mutants["counts"].items())
    note = (
        f"{mutants['mutants']} small faults{drawn}, one at a time, in {coverage['lines']} statements: {counts}. The "
        f"same tests reach {coverage['percent']:.1f} % of statements and branches. Those that no test noticed:"
    )
    lines = [("place", "is", "became")]
    for one in mutants["survivors"]:
        cells = (f"`{one[key]}`".replace("|", "\\|").replace("\n", " ") for key in ("before", "after"))
        lines.append((f"{one['file']}:{one['line']}", *cells))
    return f"{note}\n\n{markdown_table(lines)}"


def _sources(parts: Mapping[str, Mapping]) -> str:
    lines = [("part", "command", "commit", "machine")]
    for name, part in parts.items():
        own = "scripts/mutate_guard.py" if name == "mutants" else f"scripts/try_bridge.py --parts '[{name}]'"
        lines.append((name, f"`python {own}`", part["commit"], part["machine"]))
    return markdown_table(lines)
