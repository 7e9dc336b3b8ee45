"""A drive once more, from its black box: the same inputs at the same times must give the same bytes (R29)."""

import json
from dataclasses import dataclass
from pathlib import Path

from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.black_box import CAP
from aerial2ground.guard.guard import Guard, GuardSettings
from hashnerf.errors import UserError

LOG = "log.jsonl"
WRONG = (KeyError, TypeError, ValueError, AttributeError, OverflowError, UserError)
"""What a black box raises that is none, or was changed by hand."""
LARGEST = 2 * CAP


@dataclass(frozen=True)
class Replay:
    """What came of it."""

    periods: int
    """That the black box holds."""
    different: int
    """Of them, how many gave other bytes."""
    faults: tuple[str, ...]
    """Names of the faults that were latched, in order."""


def read_log(folder: Path) -> list[dict]:
    """Returns the lines of a black box, the car's numbers first; a last line that was cut is left out.

    Raises UserError where there is no black box, or a line before the last is damaged.
    """
    file = folder / LOG
    if not file.is_file():
        raise UserError(f"{file}: no such black box; give the folder of one drive, below --log")
    if file.stat().st_size > LARGEST:
        raise UserError(f"{file}: is over {LARGEST // 10**6} MB; a black box ends at {CAP // 10**6}")
    lines = file.read_bytes().splitlines()
    records = []
    for number, line in enumerate(lines, 1):
        try:
            record = json.loads(line)
            if not isinstance(record, dict):
                raise ValueError("not a group of keys")
            records.append(record)
        except (ValueError, RecursionError) as error:
            if number < len(lines):  # the last one may be cut, as the power was
                raise UserError(f"{file}: line {number} is no record; the black box is damaged") from error
    return records


def replay(folder: Path) -> Replay:
    """Drives a guard by what the black box says happened; raises UserError for a black box that is damaged."""
    head, *records = read_log(folder) or [{}]
    try:
        guard = Guard(Actuation(**head["actuation"]), GuardSettings(**head["guard"]))
        different, faults = 0, []
        for record in records:
            for now, kind, value in record["in"]:
                guard.take(kind, value, now)
            different += b"".join(guard.tick(record["t"])).hex() != record["out"]
            if guard.fault is not None and (not faults or faults[-1] != guard.fault.name):
                faults.append(guard.fault.name)
    except WRONG as error:
        raise UserError(f"{folder / LOG}: is no black box of this version ({error}); replay it with its own") from error
    return Replay(len(records), different, tuple(faults))
