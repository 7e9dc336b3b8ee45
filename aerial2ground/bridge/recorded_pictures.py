"""The pictures that a drive was steered by, kept to the bit, so that the drive can be answered again.

A recording is a folder of three files. `recording.json`: the camera's calibration. `pictures.raw`: the device's
pictures one after another, uint8 RGB. `index.jsonl`: for each of them its number, when it was taken, its CRC-32 and
what the network answered. Writing is a thread's work: a slow disk loses pictures of the recording, but no time.
"""

import binascii
import json
import queue
import shutil
import threading
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from aerial2ground.bridge.camera_source import Shot
from aerial2ground.bridge.car_file import CameraCalibration
from aerial2ground.bridge.rectification import Rectifier
from aerial2ground.exported_policy import ExportedPolicy
from hashnerf.errors import UserError

ABOUT, PICTURES, INDEX = "recording.json", "pictures.raw", "index.jsonl"
WAITING = 16
"""Pictures that may wait for the disk; further ones are dropped."""
SPARE = 500_000_000
"""Bytes of the disk that are left to others: the guard's log must still fit."""
CLOSING = 2.0
"""Seconds that closing waits for the disk."""


@dataclass(frozen=True)
class Recorded:
    """One picture of a recording."""

    number: int
    """The camera's count."""
    taken: float
    """Monotonic seconds of the drive."""
    crc: int
    """CRC-32 of the picture."""
    answer: float
    """What the network answered, radians."""
    picture: UInt8[np.ndarray, "h w 3"]
    """As the device gave it, RGB."""


class Recorder:
    """Writes pictures into a new folder; raises UserError where something is in it already, or it cannot be made."""

    def __init__(self, folder: Path, lens: CameraCalibration):
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise UserError(f"{folder}: is there already; give record a new folder")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / ABOUT).write_text(json.dumps(asdict(lens)), encoding="utf-8")
            for name in (PICTURES, INDEX):
                (folder / name).touch()
        except OSError as error:
            raise UserError(f"{folder}: cannot be written ({error.strerror}); give record another folder") from error
        self._folder = folder
        self.written = self.dropped = 0
        """Pictures in the recording, and pictures that the disk was too slow or too full for."""
        self._waiting: queue.Queue = queue.Queue(WAITING)
        self._thread = threading.Thread(target=self._write, name="recorder", daemon=True)
        self._thread.start()

    def __call__(self, shot: Shot, crc: int, answer: float) -> None:
        """Takes a picture and the network's answer (rad); never waits."""
        try:
            self._waiting.put_nowait((shot, crc, answer))
        except queue.Full:
            self.dropped += 1

    def close(self) -> None:
        """Writes what waits, for at most `CLOSING` seconds."""
        try:
            self._waiting.put(None, timeout=CLOSING)
        except queue.Full:
            return  # the disk hangs; the thread ends with the process
        self._thread.join(CLOSING)

    def _write(self) -> None:
        with open(self._folder / PICTURES, "ab") as pictures, open(self._folder / INDEX, "a") as index:
            while (item := self._waiting.get()) is not None:
                shot, crc, answer = item
                line = {"number": shot.number, "taken": shot.taken, "crc": crc, "answer": answer}
                try:
                    if shutil.disk_usage(self._folder).free < SPARE + shot.picture.nbytes:
                        self.dropped += 1
                        continue
                    pictures.write(np.ascontiguousarray(shot.picture).data)
                    pictures.flush()
                    index.write(json.dumps(line) + "\n")
                    index.flush()
                    self.written += 1
                except OSError:
                    self.dropped += 1
                    break  # half a picture may be in the file: nothing after it would be in its place
            else:
                return
            while self._waiting.get() is not None:
                self.dropped += 1


def recorded_pictures(folder: Path) -> Iterator[Recorded]:
    """Yields the pictures of a recording in order.

    A last line without an end, as a killed process leaves it, is passed over. Raises UserError for a folder that is no
    recording, and for a picture that is not the one that was recorded.
    """
    lens = recorded_lens(folder)
    shape = lens.height, lens.device_width, 3
    with open(folder / PICTURES, "rb") as pictures, open(folder / INDEX, encoding="utf-8") as index:
        for line in index:
            if not line.endswith("\n"):
                return
            try:
                entry = json.loads(line)
                about = int(entry["number"]), float(entry["taken"]), int(entry["crc"]), float(entry["answer"])
            except (ValueError, KeyError, TypeError) as error:
                raise UserError(f"{folder / INDEX}: {line.strip()[:80]!r} is no line of a recording") from error
            data = pictures.read(int(np.prod(shape)))
            if binascii.crc32(data) != about[2]:
                raise UserError(f"{folder / PICTURES}: picture {about[0]} is damaged; record the drive again")
            yield Recorded(*about, np.frombuffer(data, np.uint8).reshape(shape))


def recorded_lens(folder: Path) -> CameraCalibration:
    """Returns the calibration of the camera of a recording; raises UserError for a folder that is none."""
    missing = [name for name in (ABOUT, PICTURES, INDEX) if not (folder / name).is_file()]
    if missing:
        raise UserError(f"{folder}: lacks {', '.join(missing)}; start the drive with --record true")
    try:
        return CameraCalibration(**json.loads((folder / ABOUT).read_text(encoding="utf-8")))
    except (ValueError, TypeError, UserError) as error:
        raise UserError(f"{folder / ABOUT}: is no camera's calibration ({error}); record the drive again") from error


def replay_answers(folder: Path, policy: ExportedPolicy) -> float:
    """Returns the largest difference (rad) between the recorded answers and `policy`'s to the same pictures.

    0 means that the same file answers to the bit as it did on the car. Raises UserError for a folder without pictures.
    """
    rectify = Rectifier(recorded_lens(folder), policy.info)
    apart = [abs(policy(rectify(one.picture)) - one.answer) for one in recorded_pictures(folder)]
    if not apart:
        raise UserError(f"{folder}: holds no whole picture; record a longer drive")
    return max(apart)
