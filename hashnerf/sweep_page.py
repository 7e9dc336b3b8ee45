"""The page of speed against accuracy: for each sweep its table, its chart, what more cost does not buy, its presets."""

import shlex
from collections.abc import Sequence

from hashnerf.report_tables import DASH, number
from hashnerf.results_page import markdown_table
from hashnerf.sweep import BASE, COMBINED, MEMORY, TIME, Figure, Sweep
from hashnerf.sweep_presets import chosen_presets, front_of, worse_for_more
from hashnerf.sweep_runs import Result

FRONT = "●"


def sweep_section(sweep: Sweep, results: Sequence[Result], picture: str) -> str:
    """Returns Markdown about one sweep; `picture` is the file name of its chart."""
    failed = [one for one in results if one.reason]
    parts = [f"## {sweep.title}", sweep.about, provenance_line(sweep, results)]
    if len(failed) < len(results):
        parts += [f"![Accuracy against cost]({picture})", markdown_table(table_rows(sweep, results))]
        parts.append(f"{FRONT}: no other row is both cheaper and at least as accurate (the front).")
        parts += ["\n".join(monotonicity_lines(sweep, results)), preset_lines(sweep, results)]
    if failed:
        parts.append("\n".join(f"- **{one.row.name}** failed: {one.reason}" for one in failed))
    return "\n\n".join(part for part in parts if part)


def table_rows(sweep: Sweep, results: Sequence[Result]) -> list[list[str]]:
    """Returns the cells of a sweep's table, the head first: the base, then each knob's values, then combinations."""
    front = {one.row.name for one in front_of(sweep, results)}
    shown = [name for name in (TIME, MEMORY, *sweep.figures) if any(name in one.figures for one in results)]
    shown = list(dict.fromkeys(shown))
    head = ["varied", "value", *(_emphasis(sweep, name) for name in shown), "front"]
    rows = [head]
    for one in results:
        cells = [_value(one.figures.get(name), sweep.figures[name]) for name in shown]
        rows.append([*varied(sweep, one), *cells, FRONT if one.row.name in front else ""])
    return rows


def varied(sweep: Sweep, result: Result) -> tuple[str, str]:
    """Returns which knob a row varies and its value; of the base and of combinations the settings."""
    knob = result.row.knob
    if knob in (BASE, COMBINED):
        base = {name: own.values[0] for name, own in sweep.knobs.items()}
        names = [name for name in sweep.knobs if knob == BASE or result.row.settings[name] != base[name]]
        return knob, ", ".join(f"{name} {sweep.knobs[name].label(result.row.settings[name])}" for name in names)
    return knob, sweep.knobs[knob].label(result.row.settings[knob])


def monotonicity_lines(sweep: Sweep, results: Sequence[Result]) -> list[str]:
    """Returns a line for every knob with a dearer value that is less accurate than a cheaper one, or one for all."""
    accuracy, lines = sweep.figures[sweep.accuracy], []
    for knob in sweep.knobs:
        for cheaper, dearer in worse_for_more(sweep, results, knob):
            values = [sweep.knobs[knob].label(one.row.settings[knob]) for one in (cheaper, dearer)]
            figures = [_value(one.figures[sweep.accuracy], accuracy) for one in (cheaper, dearer)]
            lines.append(
                f"- {knob}: {values[1]} costs more than {values[0]} and is worse: {figures[1]} after {figures[0]}."
            )
    chance = f"{sweep.noise * accuracy.scale:g} {accuracy.unit}".strip()
    if not lines:
        return [f"Along no knob is a dearer value less accurate than a cheaper one by more than chance ({chance})."]
    return [f"Where more cost buys less accuracy, by more than chance ({chance}):", "", *lines]


def preset_lines(sweep: Sweep, results: Sequence[Result]) -> str:
    """Returns the table of the chosen presets with their options, empty where the sweep names none."""
    chosen = chosen_presets(sweep, results)
    if not chosen:
        return ""
    cost, accuracy = sweep.figures[sweep.cost], sweep.figures[sweep.accuracy]
    rows = [["preset", "rule", sweep.cost, sweep.accuracy, "options"]]
    for name, one in chosen.items():
        allowed = sweep.presets[name]
        rule = f"cheapest within {allowed * accuracy.scale:g} {accuracy.unit} of the best" if allowed else "the best"
        figures = (_value(one.figures[sweep.cost], cost), _value(one.figures[sweep.accuracy], accuracy))
        options = shlex.join(options_of(sweep, one))
        rows.append([name, rule, *figures, f"`{options}`" if options else "the base"])
    return f"Presets, all of the front, so that none dominates another:\n\n{markdown_table(rows)}"


def options_of(sweep: Sweep, result: Result) -> list[str]:
    """Returns the options of the scripts that make a row from the base."""
    pairs = []
    for name, knob in sweep.knobs.items():
        value = result.row.settings[name]
        if value != knob.values[0]:
            pairs += [f"--{key}={part}" for key, part in zip(knob.keys, value)]
    return pairs


def provenance_line(sweep: Sweep, results: Sequence[Result]) -> str:
    """Returns how many rows there are and where, when and by which commit they were measured."""
    done = sum(not one.reason for one in results)
    known = {key: _listed([getattr(one, key) for one in results]) for key in ("machine", "commit")}
    days = _listed([one.date[:10] for one in results])
    seed = sweep.options.get("seed", 0)
    return f"{done} of {len(sweep.rows())} rows; {known['machine']}; commit {known['commit']}; {days}; seed {seed}."


def page(sections: Sequence[str], command: str, whole_runs: str) -> str:
    """Returns the whole page."""
    about = (
        f"`{command}` writes this page. Every row is trained and measured in processes of its own; `time` (of all "
        "processors: other work on the machine hardly changes it) and `memory` (peak of the largest process) are those "
        "of the stages that are named. The runs are short, so that a row takes about a minute: what counts is how rows "
        "compare, not the level that they reach."
    )
    return "\n\n".join(["# Speed against accuracy", about, *sections, whole_runs]).rstrip() + "\n"


def _emphasis(sweep: Sweep, name: str) -> str:
    return f"**{name}**" if name in (sweep.cost, sweep.accuracy) else name


def _listed(values: Sequence[str]) -> str:
    return ", ".join(dict.fromkeys(value for value in values if value)) or DASH


def _value(value: float | None, figure: Figure) -> str:
    """Three significant digits at least: what rows differ in must be seen."""
    if value is None:
        return DASH
    scaled = abs(value) * figure.scale
    digits = 0 if scaled >= 1000 else 1 if scaled >= 100 else 2 if scaled >= 1 else 4
    return number(value, figure.unit, digits)
