"""Reading and writing `transforms.json`: strict JSON in, strict JSON out, never half a file.

The format is the one of instant-ngp and nerfstudio with optional extra keys; docs/conventions.md lists them.
"""

import contextlib
import difflib
import json
import math
import os
import re
import secrets
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn

from hashnerf.errors import UserError

LARGEST_FILE = 200 * 1024 * 1024  # bytes
DEEPEST_NESTING = 50
EXTRA_KEYS = ("scene_box", "states", "branches", "branch_weights", "camera_kinds", "actors", "visibility", "world")
LARGEST_INDEX = 1_000_000  # a branch, step or camera beyond this is a mistake, and tables by index would not fit


def read_transforms(path: Path | str) -> dict:
    """Parses one JSON object; raises UserError on NaN, duplicate keys, over 200 MB, deep nesting or broken syntax."""
    document = read_json(Path(path), "a data set folder needs a transforms.json")
    if not isinstance(document, dict):
        raise UserError(f"{path}: the top level is a {type(document).__name__}; it must be an object with 'frames'")
    return document


def read_json(path: Path, advice: str) -> Any:
    """Parses a file of strict JSON; raises UserError as `read_transforms` does, `advice` where there is none."""
    text = read_text(path, advice)
    try:
        value = json.loads(
            text,
            parse_constant=lambda token: _refuse_constant(token, text),
            parse_float=_finite_float,
            object_pairs_hook=_unique_keys,
        )
        _check_nesting(value)
    except RecursionError as error:
        raise UserError(f"{path}: lists or objects are nested too deeply, over {DEEPEST_NESTING} times") from error
    except ValueError as error:  # JSONDecodeError, and ours from the hooks
        raise UserError(f"{path}: is not strict JSON: {error}") from error
    return value


def read_text(path: Path, advice: str) -> str:
    """Reads a file of UTF-8 text; raises UserError where it is none, over 200 MB, or no regular file."""
    try:
        if not path.is_file():
            raise UserError(f"{path}: not found or not a regular file; {advice}")
        size = path.stat().st_size
        if size > LARGEST_FILE:
            raise UserError(f"{path}: {size / 2**20:.0f} MB is over the limit of {LARGEST_FILE // 2**20} MB")
        return path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: is not UTF-8 text (byte {error.start}); save it as UTF-8") from error


def write_transforms(path: Path | str, document: dict) -> None:
    """Writes strict JSON through a temporary file, so that a crash leaves the old file or the new one, never a part.

    Raises UserError when a value is not finite or not JSON.
    """
    path = Path(path)
    try:
        text = json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False)
    except (ValueError, TypeError, RecursionError) as error:
        raise UserError(f"{path}: cannot be written as strict JSON: {error}") from error
    write_atomically(path, (text + "\n").encode("utf-8"))


def write_atomically(path: Path, data: bytes) -> None:
    """Puts bytes in place in one step: temporary file in the same folder, fsync, rename; makes the folder.

    Raises UserError when the file system refuses.
    """
    temporary = path.with_name(f".{path.name[:50]}.{secrets.token_hex(8)}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(temporary, "xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        with contextlib.suppress(OSError):  # after the rename there is nothing left to remove
            os.unlink(temporary)


def _refuse_constant(token: str, text: str) -> NoReturn:
    # the parser tells no position: the first such token outside of all strings
    outside = re.sub(r'"(?:[^"\\]|\\.)*"', lambda string: "_" * len(string[0]), text)
    line = text.count("\n", 0, outside.find(token)) + 1
    raise ValueError(f"the token {token} in line {line} is not JSON; write a finite number or null")


def _finite_float(text: str) -> float:
    value = float(text)
    if math.isinf(value):
        raise ValueError(f"the number {text[:40]} is too large; write a finite number or null")
    return value


def _check_nesting(document: object) -> None:
    """Deep nesting is legal JSON, but everything that later prints or copies it would run out of stack."""
    stack = [(document, 1)]
    while stack:
        node, depth = stack.pop()
        if depth > DEEPEST_NESTING:
            raise RecursionError
        children = node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
        stack += [(child, depth + 1) for child in children if isinstance(child, (dict, list))]


def _unique_keys(pairs: list[tuple[str, object]]) -> dict:
    result = dict(pairs)
    if len(result) != len(pairs):
        seen: set[str] = set()
        repeated = next(key for key, _ in pairs if key in seen or seen.add(key))
        raise ValueError(f"the key {repeated!r} appears twice in one object")
    return result


def is_index(value: object) -> bool:
    """Whether a JSON value is an integer from 0 to a million (true and false are not)."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= LARGEST_INDEX


def is_number(value: object) -> bool:
    """Whether a JSON value is a finite number (true and false are not)."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e300


def is_point(value: object) -> bool:
    """Whether a JSON value is a list of three finite numbers."""
    return isinstance(value, list) and len(value) == 3 and all(is_number(number) for number in value)


def check_extras(document: dict, views: list[tuple[int, int, int]]) -> list[str]:
    """Every problem in the optional top-level keys, one line each; `views` holds each frame's branch, step, camera."""
    checks = (_scene_box, _states, _names, _branch_weights, _actors, _visibility, _world)
    return [problem for check in checks for problem in check(document, views)]


def misspelled(entry: dict, known: tuple[str, ...]) -> list[str]:
    """One line for each key that is almost a known one which is absent; keys of other tools are left alone."""
    absent = [key for key in known if key not in entry]
    close = {key: _almost(key.lower(), absent) for key in entry if key not in known}
    return [f"the key {key[:40]!r} is unknown; did you mean {match[0]!r}?" for key, match in close.items() if match]


def _almost(key: str, known: list[str]) -> list[str]:
    # letters in another order are a slip in short keys, too, where one wrong letter may be another tool's word
    swapped = [word for word in known if sorted(word) == sorted(key)]
    return swapped or difflib.get_close_matches(key, known, n=1, cutoff=0.85)


def _scene_box(document: dict, views: list[tuple[int, int, int]]) -> Iterator[str]:
    box = document.get("scene_box")
    if box is None:
        return
    if not (isinstance(box, list) and len(box) == 2 and all(is_point(corner) for corner in box)):
        yield "scene_box must be [[x0, y0, z0], [x1, y1, z1]] with finite numbers in metres"
    elif not all(low < high for low, high in zip(*box)):
        yield f"scene_box {box}: every lower corner coordinate must be below the upper one"


def _states(document: dict, views: list[tuple[int, int, int]]) -> Iterator[str]:
    states = document.get("states")
    if states is None:
        return
    if not isinstance(states, list):
        yield "states must be a list of {branch, step, hazard}"
        return
    seen = {(branch, step) for branch, step, _ in views}
    listed = set()
    for row, entry in enumerate(states):
        keys = {"branch": is_index, "step": is_index, "hazard": lambda value: value is None or isinstance(value, bool)}
        problem = _entry(entry, keys, optional=("hazard",))
        if problem is not None:
            yield f"states[{row}] {problem}"
            continue
        state = (entry["branch"], entry["step"])
        if state in listed:
            yield f"states[{row}]: branch {state[0]} step {state[1]} is listed twice"
        elif state not in seen:
            yield f"states[{row}]: branch {state[0]} step {state[1]} has no frame that shows it"
        listed.add(state)
    for branch, step in sorted(seen - listed):
        yield f"states does not list branch {branch} step {step}, which frames show"


def _names(document: dict, views: list[tuple[int, int, int]]) -> Iterator[str]:
    for key, position in (("branches", 0), ("camera_kinds", 2)):
        names = document.get(key)
        if names is None:
            continue
        needed = 1 + max((view[position] for view in views), default=0)
        if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
            yield f"{key} must be a list of names"
        elif len(names) < needed:
            yield f"{key} has {len(names)} names but the frames use the indices 0 to {needed - 1}"


def _branch_weights(document: dict, views: list[tuple[int, int, int]]) -> Iterator[str]:
    weights = document.get("branch_weights")
    if weights is None:
        return
    needed = 1 + max((view[0] for view in views), default=0)
    if not (isinstance(weights, list) and all(is_number(weight) and weight > 0 for weight in weights)):
        yield "branch_weights must be a list of positive numbers"
    elif len(weights) != needed:
        yield f"branch_weights has {len(weights)} numbers but the frames use the branches 0 to {needed - 1}"


def _actors(document: dict, views: list[tuple[int, int, int]]) -> Iterator[str]:
    seen = {(branch, step) for branch, step, _ in views}
    keys = {
        "branch": is_index,
        "step": is_index,
        "center": is_point,
        "size": lambda value: is_point(value) and min(value) > 0,
        "yaw": is_number,
    }
    listed = set()
    for name, where, entry in _named_lists(document, "actors"):
        problem = entry if isinstance(entry, str) else _entry(entry, keys)
        if problem is not None:
            yield f"{where} {problem}"
            continue
        state = (entry["branch"], entry["step"])
        if state not in seen:
            yield f"{where} is at branch {state[0]} step {state[1]}, a state that no frame shows"
        if (name, state) in listed:
            yield f"{where} repeats branch {state[0]} step {state[1]}; an actor has one box a state"
        listed.add((name, state))


def _visibility(document: dict, views: list[tuple[int, int, int]]) -> Iterator[str]:
    seen = {(branch, step) for branch, step, _ in views}
    cameras = {camera for _, _, camera in views}
    for _, where, entry in _named_lists(document, "visibility"):
        if isinstance(entry, str):
            yield f"{where} {entry}"
        elif not (isinstance(entry, list) and len(entry) == 5 and all(is_index(number) for number in entry)):
            yield f"{where} must be [branch, step, camera, visible_px, unoccluded_px] with integers from 0 up"
        elif tuple(entry[:2]) not in seen or entry[2] not in cameras:
            yield f"{where} names branch {entry[0]} step {entry[1]} camera {entry[2]}, which no frame shows"
        elif entry[3] > entry[4]:
            yield f"{where} has {entry[3]} visible pixels but only {entry[4]} without occlusion"


def _world(document: dict, views: list[tuple[int, int, int]]) -> Iterator[str]:
    if not isinstance(document.get("world"), (dict, type(None))):
        yield "world must be an object"


def _named_lists(document: dict, key: str) -> Iterator[tuple[str, str, object]]:
    """(name, where it is, entry) for all of {name: [entry, ...]}; a string in place of an entry says what is wrong."""
    table = document.get(key)
    if table is None:
        return
    if not isinstance(table, dict):
        yield "", key, "must be an object of lists by actor name"
        return
    for name, entries in table.items():
        if not isinstance(entries, list):
            yield name, f"{key}.{name}", "must be a list"
            continue
        for row, entry in enumerate(entries):
            yield name, f"{key}.{name}[{row}]", "must be an object or list" if isinstance(entry, str) else entry


def _entry(entry: object, keys: dict[str, Callable], optional: tuple[str, ...] = ()) -> str | None:
    if not isinstance(entry, dict):
        return f"must be an object with the keys {', '.join(keys)}"
    for key, accepts in keys.items():
        if key not in entry and key not in optional:
            return f"lacks the key {key!r}"
        if key in entry and not accepts(entry[key]):
            return f"has {key} = {str(entry[key])[:60]}, which is not allowed there"
    unknown = sorted(set(entry) - set(keys))
    return f"has the unknown key {unknown[0]!r}; known are {', '.join(keys)}" if unknown else None
