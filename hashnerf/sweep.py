"""A sweep: settings that cost time are varied one at a time and in combinations, and every row is measured.

A sweep is a YAML file (`load_sweep`):

    title, about       words for the page
    base               config files that every stage gets, in order
    options            {key: value} that every stage gets
    stages             {name: "script.py --key value ..."}, run in order, every one in a process of its own
    shared             {name, options, stages}: a run that is made once; every row starts from a copy of it
    timed              the stages whose processor seconds (of all threads; other work on the machine hardly changes
                       them) and peak memory are a row's `time` and `memory`
    figures            {name: {file, key, unit, better: more | less}}: where results are, a file in the run's folder and
                       a dotted key in it, in which `*` is the mean over all there is
    cost, accuracy     the names of two figures; the cost may be `time`
    noise              differences of accuracy up to this many units are chance
    knobs              {name: {key | keys, values, stage}}: the first value is the base; `stage` names the only stage
                       that is told, where the other scripts do not know the key
    pareto             {knob: values}: all their combinations
    presets            {name: allowed}: of all rows on the front the cheapest whose accuracy is at most so many units
                       below the best

Scripts are given `--config`, `--runs`, `--name` and `--key value`, nothing else is known of them.
"""

import json
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

from hashnerf.command_line import nearest, read_yaml
from hashnerf.errors import UserError

TIME, MEMORY = "time", "memory"
BASE, COMBINED = "base", "combined"
GREATEST_PRODUCT = 200
"""Combinations: a slip in a list of values must not become a week of training."""


@dataclass(frozen=True)
class Figure:
    """A number that is measured of every row."""

    unit: str
    more_is_better: bool
    file: str = ""
    """File below the run's folder, empty where the sweep itself counts."""
    key: str = ""

    @property
    def scale(self) -> int:
        """What a value is multiplied by to be in the unit: per cent and points are stored as shares."""
        return 100 if self.unit in ("%", "points") else 1

    def loss(self, value: float) -> float:
        """Returns the value so that smaller is better."""
        return -value if self.more_is_better else value


@dataclass(frozen=True)
class Knob:
    """A setting: its keys, its values (one number for every key), and the stage that alone is told."""

    keys: tuple[str, ...]
    values: tuple[tuple[Any, ...], ...]
    stage: str = ""

    def label(self, value: tuple[Any, ...]) -> str:
        """Returns a value as it is shown."""
        parts = [part for one in value for part in (one if isinstance(one, list) else [one])]
        return " x ".join(str(part) for part in parts)


@dataclass(frozen=True)
class SharedRun:
    """A run that rows start from."""

    name: str
    stages: Mapping[str, str]
    options: Mapping[str, Any]


@dataclass(frozen=True)
class Row:
    """One setting of all knobs."""

    name: str
    """Also the name of its folder."""
    knob: str
    """The knob that differs from the base; `base` or `combined`."""
    settings: Mapping[str, tuple[Any, ...]]
    """The value of every knob."""


@dataclass(frozen=True)
class Sweep:
    """What is varied and what is measured; the module says what the parts mean."""

    name: str
    title: str
    stages: Mapping[str, str]
    timed: tuple[str, ...]
    figures: Mapping[str, Figure]
    cost: str
    accuracy: str
    noise: float
    knobs: Mapping[str, Knob]
    pareto: Mapping[str, tuple[tuple[Any, ...], ...]]
    presets: Mapping[str, float]
    base: tuple[str, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    shared: SharedRun | None = None
    about: str = ""

    def rows(self) -> list[Row]:
        """Returns the base, every other value of every knob alone, and the combinations, no setting twice."""
        base = {name: knob.values[0] for name, knob in self.knobs.items()}
        rows = [Row(BASE, BASE, base)]
        for name, knob in self.knobs.items():
            rows += [Row(_file_name(name, knob.label(value)), name, base | {name: value}) for value in knob.values[1:]]
        for number, values in enumerate(product(*self.pareto.values()) if self.pareto else (), 1):
            rows.append(Row(_file_name(COMBINED, str(number)), COMBINED, base | dict(zip(self.pareto, values))))
        found: dict[str, Row] = {}
        for row in rows:
            found.setdefault(json.dumps(row.settings), row)
        return list(found.values())

    def commands(self, row: Row, runs: Path, scripts: Path) -> dict[str, list[str]]:
        """Returns the command of every stage of a row whose folder is below `runs`."""
        return {
            stage: _command(command, self.base, self.options | self._told(stage, row), runs, row.name, scripts)
            for stage, command in self.stages.items()
        }

    def shared_commands(self, runs: Path, scripts: Path) -> dict[str, list[str]]:
        """Returns the commands of the shared run, none without one."""
        if self.shared is None:
            return {}
        given, options = self.shared.stages, self.options | self.shared.options
        return {
            stage: _command(command, self.base, options, runs, self.shared.name, scripts)
            for stage, command in given.items()
        }

    def _told(self, stage: str, row: Row) -> dict[str, Any]:
        told: dict[str, Any] = dict(self.shared.options) if self.shared else {}
        for name, knob in self.knobs.items():
            if knob.stage in ("", stage):
                told |= dict(zip(knob.keys, row.settings[name]))
        return told


def load_sweep(path: Path) -> Sweep:
    """Reads a sweep file; raises UserError naming file, key and value where something is missing or does not fit."""
    data = read_yaml(path)
    known = [name for name in Sweep.__dataclass_fields__ if name != "name"]
    _check_keys(data, known, ("title", "stages", "timed", "figures", "cost", "accuracy", "knobs"), str(path))
    figures = {name: _figure(one, f"{path}: figures.{name}") for name, one in data["figures"].items()}
    figures |= {TIME: Figure("s", False), MEMORY: Figure("MB", False)}
    knobs = {name: _knob(one, f"{path}: knobs.{name}") for name, one in data["knobs"].items()}
    stages = data["stages"]
    for key in ("cost", "accuracy"):
        _check_known(data[key], figures, f"{path}: {key}")
    for stage in data["timed"]:
        _check_known(stage, stages, f"{path}: timed")
    for knob in knobs.values():
        if knob.stage:
            _check_known(knob.stage, stages, f"{path}: knobs")
    pareto = {}
    for name, values in (data.get("pareto") or {}).items():
        _check_known(name, knobs, f"{path}: pareto")
        pareto[name] = _values(values, knobs[name].keys, f"{path}: pareto.{name}")
    sweep = Sweep(
        name=path.stem,
        title=data["title"],
        about=data.get("about", ""),
        base=tuple(data.get("base", ())),
        options=data.get("options", {}),
        stages=stages,
        shared=_shared(data.get("shared"), f"{path}: shared"),
        timed=tuple(data["timed"]),
        figures=figures,
        cost=data["cost"],
        accuracy=data["accuracy"],
        noise=float(data.get("noise", 0.0)),
        knobs=knobs,
        pareto=pareto,
        presets={name: float(allowed) for name, allowed in data.get("presets", {}).items()},
    )
    names = [row.name for row in sweep.rows()]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise UserError(f"{path}: two rows would share the folder {twice[0]}; rename a knob or change its values")
    if len(sweep.rows()) > GREATEST_PRODUCT:
        raise UserError(f"{path}: makes {len(sweep.rows())} rows; give fewer values, {GREATEST_PRODUCT} rows at most")
    return sweep


def _figure(data: Any, where: str) -> Figure:
    needed = ("unit", "better", "file", "key")
    _check_keys(data, needed, needed, where)
    if data["better"] not in ("more", "less"):
        raise UserError(f"{where}: better is {data['better']!r}; give more or less")
    return Figure(data["unit"], data["better"] == "more", data["file"], data["key"])


def _knob(data: Any, where: str) -> Knob:
    _check_keys(data, ("key", "keys", "values", "stage"), ("values",), where)
    keys = tuple(data["keys"]) if "keys" in data else (data.get("key"),)
    if None in keys or not data["values"]:
        raise UserError(f"{where}: needs a key (or keys) and at least one value")
    return Knob(keys, _values(data["values"], keys, where), data.get("stage", ""))


def _values(given: Any, keys: Sequence[str], where: str) -> tuple[tuple[Any, ...], ...]:
    values = tuple(_as_value(value) for value in given)
    for value in values:
        if len(value) != len(keys):
            raise UserError(f"{where}: value {list(value)} is not one for each of {', '.join(keys)}")
    return values


def _as_value(value: Any) -> tuple[Any, ...]:
    return tuple(value) if isinstance(value, list) else (value,)


def _shared(data: Any, where: str) -> SharedRun | None:
    if data is None:
        return None
    _check_keys(data, ("name", "stages", "options"), ("name", "stages"), where)
    return SharedRun(data["name"], data["stages"], data.get("options", {}))


def _check_keys(data: Any, known: Sequence[str], needed: Sequence[str], where: str) -> None:
    if not isinstance(data, Mapping):
        raise UserError(f"{where}: is {data!r}; give `key: value` lines")
    for name in data:
        if name not in known:
            raise UserError(f"{where}: unknown key {name!r}; {nearest(str(name), list(known))}")
    missing = [name for name in needed if name not in data]
    if missing:
        raise UserError(f"{where}: lacks {', '.join(missing)}")


def _check_known(name: Any, known: Mapping, where: str) -> None:
    if name not in known:
        raise UserError(f"{where}: {name!r} is not there; {nearest(str(name), list(known))}")


def _command(
    command: str, base: Sequence[str], options: Mapping[str, Any], runs: Path, name: str, scripts: Path
) -> list[str]:
    script, *own = shlex.split(command)
    layers = [word for file in base for word in ("--config", file)]
    place = ["--runs", str(runs), "--name", name]
    given = [word for key, value in options.items() for word in (f"--{key}", _as_argument(value))]
    return [str(scripts / script), *layers, *place, *given, *own]


def _as_argument(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _file_name(*words: str) -> str:
    return re.sub(r"[^a-zA-Z0-9.]+", "_", " ".join(words)).strip("_").replace(".", "p")
