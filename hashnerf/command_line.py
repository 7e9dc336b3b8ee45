"""Configs and scripts: strict YAML files and command-line overrides become frozen dataclasses.

A config class is a frozen dataclass whose fields may be dataclasses themselves. Keys are dotted paths (`train.steps`).
Later sources win: defaults of the class, then each `--config` file in order, then `--key value` arguments.
This module never imports torch at load time, so that a typing mistake is answered at once.
"""

import argparse
import dataclasses
import difflib
import errno
import os
import re
import sys
import typing
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import jsonargparse
import yaml

from hashnerf.errors import UserError
from hashnerf.heap import keep_freed_memory

Config = TypeVar("Config")

MAX_CONFIG_BYTES = 1_000_000
MAX_CONFIG_DEPTH = 30
DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)

jsonargparse.set_parsing_settings(docstring_parse_attribute_docstrings=True)


def parse_config(
    config_class: type[Config], argv: Sequence[str] | None = None, description: str | None = None
) -> Config:
    """Build a config from `--config FILE` layers and `--key value` overrides; UserError names file, key and value."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    files, overrides = _split_config_files(arguments)
    usage = "%(prog)s [--config FILE]... [--key value]..."
    parser = jsonargparse.ArgumentParser(exit_on_error=False, allow_abbrev=False, usage=usage, description=description)
    parser.add_argument(
        "--config", metavar="FILE", help="YAML file with these keys; may be repeated, the last one wins."
    )
    parser.add_class_arguments(config_class)
    _hide_groups(parser)
    for file in files:
        parser.set_defaults(_typed_values(config_class, read_yaml(Path(file)), file))
    return _parse_overrides(parser, config_class, overrides)


def load_config(config_class: type[Config], path: Path) -> Config:
    """Read one YAML file written by `save_config` (or by hand) into a config."""
    return parse_config(config_class, ["--config", str(path)])


def read_yaml(path: Path) -> dict[str, Any]:
    """Read one config file as a dict; UserError when it is missing, too large, or not strict YAML."""
    if not path.is_file():
        raise UserError(f"{path}: no such config file; check the path after --config.")
    if path.stat().st_size > MAX_CONFIG_BYTES:
        raise UserError(f"{path}: larger than {MAX_CONFIG_BYTES} bytes; this is not a config file.")
    try:
        data = _StrictLoader(path.read_text(encoding="utf-8")).get_single_data()
    except yaml.MarkedYAMLError as error:
        line = f" in line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise UserError(f"{path}: {error.problem}{line}; mend the YAML.") from error
    except (yaml.YAMLError, ValueError, OSError, RecursionError) as error:
        raise UserError(f"{path}: cannot be read as YAML ({' '.join(str(error).split())}).") from error
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise UserError(f"{path}: holds a {type(data).__name__}, but a config is `key: value` lines.")
    return data


def save_config(config: Any, path: Path) -> None:
    """Write a config as YAML that `load_config` reads back to an equal object; the file is replaced atomically."""
    text = yaml.dump(plain_config(config), Dumper=_ConfigDumper, sort_keys=False, allow_unicode=True, width=120)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.write_text(text, encoding="utf-8")
    os.replace(temporary, path)


def plain_config(config: Any) -> Any:
    """Turn a config (dataclasses, tuples, paths) into dicts, lists, strings and numbers, as YAML and JSON have them."""
    if dataclasses.is_dataclass(config):
        return {field.name: plain_config(getattr(config, field.name)) for field in dataclasses.fields(config)}
    if isinstance(config, dict):
        return {str(key): plain_config(value) for key, value in config.items()}
    if isinstance(config, list | tuple):
        return [plain_config(value) for value in config]
    return str(config) if isinstance(config, Path) else config


def flat_config(plain: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Flatten nested dicts to one dict of dotted keys, so that two configs can be compared key by key."""
    flat: dict[str, Any] = {}
    for key, value in plain.items():
        if isinstance(value, dict):
            flat.update(flat_config(value, f"{prefix}{key}."))
        else:
            flat[prefix + key] = value
    return flat


def config_changes(old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """One line for each key whose value differs between two plain configs."""
    flat_old, flat_new = flat_config(old), flat_config(new)
    absent = "(absent)"
    return [
        f"{key}: {flat_old.get(key, absent)} -> {flat_new.get(key, absent)}"
        for key in {**flat_old, **flat_new}
        if flat_old.get(key, absent) != flat_new.get(key, absent)
    ]


def run_main(main: Callable[[], int | None]) -> NoReturn:
    """Run a script's `main` and exit, without traceback: 0 fine, 1 out of memory or disk, 2 wrong input, 130 Ctrl-C."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by whoever started us: Python has no stream to print to
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors="backslashreplace")  # a terminal that is not UTF-8 must not end a run
    keep_freed_memory()
    try:
        status = main() or 0
        sys.stdout.flush()
    except UserError as error:
        status = _complain(str(error), 2)
    except KeyboardInterrupt:
        status = _complain("Interrupted.", 130)
    except BrokenPipeError:
        # The reader (`head`, a closed terminal) has gone: say nothing, and keep the final flush from failing again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 141
    except (MemoryError, RuntimeError, OSError) as error:
        sentence, status = _exhausted(error), 1
        if sentence is None and isinstance(error, OSError) and error.filename is not None:
            sentence, status = f"{error.filename}: {error.strerror}; give another path, or mend this one.", 2
        if sentence is None:
            raise
        _complain(sentence, status)
    sys.exit(status)


def set_threads(count: int) -> None:
    """Use this many CPU threads for tensor work; 0 means OMP_NUM_THREADS, or every core this process may use."""
    import torch

    if count < 0:
        raise UserError(f"threads = {count} is negative; give 0 for all cores or the number of threads to use.")
    if count or not os.environ.get("OMP_NUM_THREADS"):  # torch has obeyed the variable since it was imported
        torch.set_num_threads(count or usable_cores())


def usable_cores() -> int:
    """The number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def nearest(word: str, known: Sequence[str]) -> str:
    """Say in one clause which known word the given one was probably meant to be, or list them all."""
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    return f"did you mean {close[0]!r}?" if close else f"known: {', '.join(sorted(known))}."


def _complain(sentence: str, status: int) -> int:
    print(sentence, file=sys.stderr)
    return status


def _exhausted(error: BaseException) -> str | None:
    """One sentence when memory or disk ran out, None for any other error."""
    if isinstance(error, OSError):
        return f"The disk is full: {error}; free some space and try again." if error.errno in DISK_FULL else None
    message = str(error)
    if isinstance(error, MemoryError) or "out of memory" in message or "DefaultCPUAllocator" in message:
        detail = message.strip().splitlines()[0] if message.strip() else "an allocation failed"
        return f"Out of memory: {detail}; use smaller batches, images or tables, or fewer samples."
    return None


def _split_config_files(arguments: list[str]) -> tuple[list[str], list[str]]:
    """Separate the values of `--config` (in order) from all other arguments."""
    files, others = [], []
    rest = iter(arguments)
    for argument in rest:
        if argument == "--config":
            file = next(rest, None)
            if file is None:
                raise UserError("--config needs the path of a YAML file after it.")
            files.append(file)
        elif argument.startswith("--config="):
            files.append(argument.removeprefix("--config="))
        else:
            others.append(argument)
    return files, others


class _ConfigDumper(yaml.SafeDumper):
    """Safe YAML with one key a line and lists on one line."""

    def represent_list(self, data: list) -> yaml.Node:
        return self.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=True)

    def ignore_aliases(self, data: Any) -> bool:
        return True  # the loader refuses aliases, so equal parts are written out


_ConfigDumper.add_representer(list, _ConfigDumper.represent_list)


class _StrictLoader(yaml.SafeLoader):
    """Safe YAML without the parts that hide mistakes or bombs: duplicate keys, aliases, deep nesting."""

    depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.MarkedYAMLError(
                problem="aliases (*name) are not accepted", problem_mark=self.peek_event().start_mark
            )
        self.depth += 1
        if self.depth > MAX_CONFIG_DEPTH:
            raise yaml.MarkedYAMLError(problem="nested too deeply", problem_mark=self.peek_event().start_mark)
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_mapping(self, node: Any, deep: bool = False) -> dict:
        seen: set[str] = set()
        for key_node, _ in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                raise yaml.MarkedYAMLError(problem="a key must be a word", problem_mark=key_node.start_mark)
            if key_node.value in seen:
                raise yaml.MarkedYAMLError(
                    problem=f"key {key_node.value!r} is given twice", problem_mark=key_node.start_mark
                )
            seen.add(key_node.value)
        return super().construct_mapping(node, deep)


def _fields(config_class: type) -> dict[str, Any]:
    """Field names of a config class with their resolved types."""
    hints = typing.get_type_hints(config_class)
    return {field.name: hints[field.name] for field in dataclasses.fields(config_class)}


def _leaves(config_class: type, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Every dotted key of a config class that is not itself a dataclass, with its type."""
    for name, hint in _fields(config_class).items():
        if dataclasses.is_dataclass(hint):
            yield from _leaves(hint, f"{prefix}{name}.")
        else:
            yield prefix + name, hint


def _typed_values(config_class: type, data: dict[str, Any], source: str, prefix: str = "") -> dict[str, Any]:
    """Check one file's values against the class and return {dotted key: value of the right type}."""
    fields = _fields(config_class)
    values: dict[str, Any] = {}
    for name, value in data.items():
        if name not in fields:
            known = {field: prefix + field for field in fields}
            raise UserError(
                f"{source}: unknown key '{prefix}{name}'; {nearest(prefix + str(name), list(known.values()))}"
            )
        if dataclasses.is_dataclass(fields[name]):
            if not isinstance(value, dict):
                raise UserError(f"{source}: {prefix}{name} = {value!r} must be a group of `key: value` lines.")
            values.update(_typed_values(fields[name], value, source, f"{prefix}{name}."))
        else:
            values[prefix + name] = _typed(fields[name], value, f"{source}: {prefix}{name}")
    return values


def _typed(hint: Any, value: Any, where: str) -> Any:
    """One value as its field's type; `1e-3`, which YAML 1.1 reads as text, is a number for a float field."""
    checker = jsonargparse.ArgumentParser(exit_on_error=False)
    checker.add_argument("--value", type=hint)
    try:
        typed = checker.parse_object({"value": value}).value
    except (jsonargparse.ArgumentError, OverflowError) as error:
        raise UserError(f"{where} = {value!r} is not valid; expected {_type_name(hint)}.") from error
    if value is None and type(None) not in typing.get_args(hint) and hint is not Any:
        raise UserError(f"{where} is empty; expected {_type_name(hint)}.")
    _refuse_nan(typed, where)
    return typed


def _refuse_nan(value: Any, where: str) -> None:
    parts = value if isinstance(value, list | tuple) else value.values() if isinstance(value, dict) else [value]
    if any(isinstance(part, float) and part != part for part in parts):
        raise UserError(f"{where} = {value!r} is not a number; give a finite value.")


def _type_name(hint: Any) -> str:
    """A type as a reader would say it: `int`, `one of 'a', 'b'`, `tuple[float, float]`, `Path or nothing`."""
    if typing.get_origin(hint) is typing.Literal:
        return "one of " + ", ".join(repr(choice) for choice in typing.get_args(hint))
    if type(None) in typing.get_args(hint):
        return " or ".join(_type_name(part) for part in typing.get_args(hint) if part is not type(None)) + " or nothing"
    return hint.__name__ if isinstance(hint, type) and not typing.get_args(hint) else str(hint).replace("typing.", "")


def _hide_groups(parser: jsonargparse.ArgumentParser) -> None:
    """Leave `--group FILE` out of the help: a whole group comes from a --config file, which is checked strictly."""
    for action in parser._actions:
        if action.metavar == "CONFIG":
            action.help = argparse.SUPPRESS


def _parse_overrides(parser: jsonargparse.ArgumentParser, config_class: type[Config], overrides: list[str]) -> Config:
    """Apply `--key value` arguments over the parser's defaults and build the config object."""
    hints = dict(_leaves(config_class))
    known = ["help", *hints]
    for argument in overrides:
        name = argument.removeprefix("--").split("=")[0]
        if argument.startswith("--") and name not in known and not any(name.startswith(f"{leaf}.") for leaf in hints):
            raise UserError(f"unknown argument --{name}; {nearest(name, known)}")
    try:
        namespace = parser.parse_args(overrides)
    except OverflowError as error:
        raise UserError(f"a number is too large ({error}); give a smaller one") from error
    except jsonargparse.ArgumentError as error:
        raise UserError(_argument_problem(str(error), hints)) from error
    del namespace["config"]
    for key in hints:
        _refuse_nan(namespace.get(key), f"--{key}")
    try:
        return config_class(**parser.instantiate(namespace).as_dict())
    except UserError as error:
        raise UserError(_with_full_key(str(error), hints)) from error


def _with_full_key(message: str, hints: dict[str, Any]) -> str:
    """A part of a config names its keys without knowing where the whole config holds it: `fit.x` for `nerf.fit.x`."""
    word = message.split(" ", 1)[0]
    if word in hints:
        return message
    whole = [key for key in hints if key.endswith(f".{word}")]
    return message.replace(word, " or ".join(whole), 1) if len(whole) in (1, 2) else message


def _argument_problem(message: str, hints: dict[str, Any]) -> str:
    """The parser's complaint about an argument as one sentence with key, value and expected type."""
    wrong = re.match(r'Parser key "([^"]+)":.*(?:Got value|Given value): (.*)', message, re.DOTALL)
    if wrong and wrong[1] in hints:
        return f"--{wrong[1]} = {wrong[2].strip()} is not valid; expected {_type_name(hints[wrong[1]])}."
    missing = re.match(r"the following arguments are required: (.*)", message)
    if missing:
        return f"needs a value for {missing[1]}: give it as an argument or in a --config file."
    return " ".join(message.split())
