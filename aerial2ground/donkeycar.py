"""Reading a recording of a small car: a donkeycar tub, version 2.

    manifest.json          one JSON value a line; the one with `paths` lists the catalogs and `deleted_indexes`
    catalog_0.catalog      one JSON object a line: `_index`, `cam/image_array`, `user/angle`, `user/throttle`
    images/                the pictures that `cam/image_array` names

Steering and throttle are shares of their greatest values, -1 to 1; positive steering turns right.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from hashnerf.errors import UserError
from hashnerf.image_files import read_rgb, resolve_inside
from hashnerf.transforms_json import is_index, is_number, read_text

PICTURE, STEERING, THROTTLE = "cam/image_array", "user/angle", "user/throttle"


@dataclass(frozen=True)
class Recording:
    """Frames of one drive in the order in which they were taken."""

    pictures: UInt8[Tensor, "n h w 3"]
    steering: Float[np.ndarray, " n"]
    throttle: Float[np.ndarray, " n"]
    index: Int[np.ndarray, " n"]
    """Numbers of the frames in the tub; deleted ones are missing."""


def read_tub(folder: Path, width: int = 0) -> Recording:
    """Reads a tub, its pictures reduced to `width` pixels by area averaging (0 keeps them).

    Raises UserError naming the file and key that is wrong.
    """
    paths, deleted = _manifest(folder / "manifest.json")
    records = [record for name in paths for record in _records(folder, name) if record["_index"] not in deleted]
    if not records:
        raise UserError(f"{folder}: holds no frame that is not deleted; record a drive first")
    pictures: list[np.ndarray] = []
    for record in records:
        try:
            picture = read_rgb(resolve_inside(folder / "images", record[PICTURE]))
        except UserError as error:
            raise UserError(f"{folder}: frame {record['_index']}: images: {error}") from error
        if 0 < picture.shape[1] < width:
            raise UserError(
                f"{folder}: pictures are {picture.shape[1]} pixels wide and width = {width}; give at most their width"
            )
        if width:
            size = (width, max(1, round(picture.shape[0] * width / picture.shape[1])))
            picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        if pictures and picture.shape != pictures[0].shape:
            raise UserError(f"{folder}: {record[PICTURE]} differs in size from the first picture; all need one size")
        pictures.append(picture)
    return Recording(
        torch.from_numpy(np.stack(pictures)),
        np.array([record[STEERING] for record in records], dtype=float),
        np.array([record[THROTTLE] for record in records], dtype=float),
        np.array([record["_index"] for record in records], dtype=np.int64),
    )


def _manifest(path: Path) -> tuple[list[str], set[int]]:
    """Names of the catalogs and numbers of the deleted frames."""
    if not path.is_file():
        raise UserError(f"{path}: does not exist; give the folder of a donkeycar tub (version 2), with its manifest")
    entries = [entry for _, entry in _json_lines(path) if isinstance(entry, Mapping) and "paths" in entry]
    if not entries:
        raise UserError(f"{path}: no line has the key 'paths'; only tubs of version 2 can be read")
    paths, deleted = entries[-1]["paths"], entries[-1].get("deleted_indexes", [])
    if not isinstance(paths, list) or not paths or not all(isinstance(name, str) for name in paths):
        raise UserError(f"{path}: 'paths' must be a list of catalog files")
    if not isinstance(deleted, list) or not all(is_index(number) for number in deleted):
        raise UserError(f"{path}: 'deleted_indexes' must be a list of frame numbers")
    return paths, set(deleted)


def _records(folder: Path, name: str) -> Iterator[Mapping]:
    try:
        path = resolve_inside(folder, name)
    except UserError as error:
        raise UserError(f"{folder / 'manifest.json'}: paths: {error}; copy the whole tub") from error
    for number, record in _json_lines(path):
        where = f"{path}: line {number}"
        if not isinstance(record, Mapping):
            raise UserError(f"{where} is not an object; every line must be one frame")
        for key in ("_index", PICTURE, STEERING, THROTTLE):
            if key not in record:
                raise UserError(f"{where} lacks the key {key!r}; record pictures together with the driver's commands")
        if not is_index(record["_index"]):
            raise UserError(f"{where}: '_index' is {str(record['_index'])[:40]!r}; it must be a frame number")
        for key in (STEERING, THROTTLE):
            if not is_number(record[key]) or not -1 <= record[key] <= 1:
                raise UserError(f"{where}: {key!r} is {str(record[key])[:40]!r}; it must be a number from -1 to 1")
        yield record


def _json_lines(path: Path) -> Iterator[tuple[int, Any]]:
    """Numbers and values of the lines of a file that are not empty."""
    for number, line in enumerate(read_text(path, "copy the whole tub").splitlines(), 1):
        if not line.strip():
            continue
        try:
            yield number, json.loads(line)
        except (ValueError, RecursionError) as error:
            raise UserError(f"{path}: line {number} is not JSON ({error}); copy the file again") from error
