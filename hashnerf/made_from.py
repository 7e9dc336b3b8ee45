"""What a folder of many files was made from, so that a later call continues it only for the same purpose.

A training run refuses another config by itself; folders of pictures or networks that are filled file by file hold
`made_from.json`, written before the first of them.
"""

import hashlib
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hashnerf.command_line import config_changes
from hashnerf.errors import UserError
from hashnerf.transforms_json import read_transforms, write_atomically

MADE_FROM = "made_from.json"
NEXT = "choose another run name, or start over with --overwrite true"


def begin(folder: Path, record: Mapping[str, Any], overwrite: bool = False) -> None:
    """Lets `folder` be filled with what `record` (plain values) describes; raises UserError if it was begun otherwise.

    With `overwrite` what is there goes first.
    """
    record = plain(record)
    if overwrite:
        shutil.rmtree(folder, ignore_errors=True)
    if folder.is_dir() and any(path.name[0] != "." for path in folder.iterdir()):
        if not (folder / MADE_FROM).is_file():
            raise UserError(f"{folder}: holds files, but no {MADE_FROM} that says what they were made from; {NEXT}")
        require_same(folder, read_transforms(folder / MADE_FROM), record)
        return
    write_atomically(folder / MADE_FROM, json.dumps(record, indent=1).encode())


def require_same(folder: Path, saved: Mapping[str, Any], record: Mapping[str, Any]) -> None:
    """Raises UserError that names what differs between two records."""
    changes = config_changes(dict(saved), plain(record))
    if changes:
        raise UserError(f"{folder}: was made from something else ({'; '.join(changes)}); {NEXT}")


def plain(record: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a record as JSON gives it back."""
    return json.loads(json.dumps(record))


def digest(*parts: Path | bytes) -> str:
    """Returns 16 hexadecimal digits of the SHA-256 of files and bytes; a file that is not there counts as empty."""
    found = hashlib.sha256()
    for part in parts:
        data = part if isinstance(part, bytes) else part.read_bytes() if part.is_file() else b""
        found.update(len(data).to_bytes(8, "big") + data)
    return found.hexdigest()[:16]
