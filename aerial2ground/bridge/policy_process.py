"""The process that sees and wants: camera -> pinhole picture -> network -> low-pass -> commands to the guard.

`python -m aerial2ground.bridge.policy_process FD SETTINGS_JSON`; FD is an inherited socket for `guard.messages`.
It never imports torch, and it decides nothing about safety: it reports what it saw and when, asks for motion only while
the guard says ARMED, and where something is wrong it ends, on which the guard brakes. It ends when the guard does.

Exit status: 0 the guard has gone, 1 a fault of the program (traceback), 2 something that the user can mend (sentence).
"""

import binascii
import json
import math
import signal
import socket
import sys
import time
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import cv2

from aerial2ground.bridge.camera_source import CameraSource, Shot, open_camera
from aerial2ground.bridge.car_file import CameraCalibration
from aerial2ground.bridge.recorded_pictures import Recorder
from aerial2ground.bridge.rectification import Rectifier
from aerial2ground.exported_policy import ExportedPolicy, load_exported
from aerial2ground.guard.messages import READY, Command
from aerial2ground.guard.priority import die_with_parent
from aerial2ground.pure_pursuit import LowPass, share_after
from hashnerf.command_line import run_main
from hashnerf.errors import UserError

LONGEST_WAIT = 0.02
"""Seconds without a new picture after which the last command is sent again, so that the guard sees us alive."""
WILD = 2.0
"""Answers beyond this multiple of the limit that a policy was trained with come from a broken one."""


@dataclass(frozen=True)
class PolicySettings:
    """What the process must know; raises UserError naming the key and what to give."""

    policy: str
    """Path of the exported policy."""
    camera: str
    """Device, video file or address of the camera, as `camera_source.open_camera` takes it."""
    lens: dict
    """The fields of `CameraCalibration`."""
    speed: float
    """Nominal speed, m/s."""
    steering_limit: float
    """Of the car, radians."""
    low_pass_seconds: float
    """Time constant of the steering's low-pass; 0.144 is half of a new command each 0.1 s; 0 for none."""
    record: str = ""
    """A new folder for the pictures that were used; empty for none."""

    def __post_init__(self):
        if not 0 <= self.speed <= 2:
            raise UserError(f"speed is {self.speed}; give 0 to 2 m/s")
        if not 0 < self.steering_limit < 1.2:
            raise UserError(f"steering_limit is {self.steering_limit}; give radians above 0 and below 1.2")
        if not 0 <= self.low_pass_seconds <= 10:
            raise UserError(f"low_pass_seconds is {self.low_pass_seconds}; give 0 to 10 seconds")

    def as_json(self) -> str:
        """The argument of the process."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> "PolicySettings":
        """Reads what `as_json` wrote; raises UserError for anything else."""
        try:
            return cls(**json.loads(text))
        except (ValueError, TypeError) as error:
            keys = ", ".join(field.name for field in fields(cls))
            raise UserError(f"the settings are not a JSON object of {keys} ({error})") from error

    def calibration(self) -> CameraCalibration:
        """The camera's; raises UserError where a field is missing, unknown or wrong."""
        try:
            return CameraCalibration(**self.lens)
        except (TypeError, UserError) as error:
            raise UserError(f"lens: {error}") from error


class GuardGoneError(Exception):
    """The guard has closed its end."""


class GuardLink:
    """Our end of the socket; never waits for the guard."""

    def __init__(self, link: socket.socket):
        self._link = link
        self.state = b""
        """The guard's last answer."""
        self.dropped = 0
        """Messages that the guard did not make room for."""

    def send(self, message: bytes) -> None:
        """Sends a message, or drops it where the guard hangs; raises GuardGoneError where it has gone."""
        try:
            self._link.send(message, socket.MSG_DONTWAIT)
        except BlockingIOError:
            self.dropped += 1
        except ConnectionError as error:
            raise GuardGoneError from error

    def listen(self) -> bytes:
        """Reads every answer that has come and returns the newest ever; raises GuardGoneError where it has gone."""
        while True:
            try:
                answer = self._link.recv(64, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return self.state
            except ConnectionError as error:
                raise GuardGoneError from error
            if not answer:
                raise GuardGoneError
            self.state = answer


class Pilot:
    """From pictures to commands."""

    def __init__(self, settings: PolicySettings, policy: ExportedPolicy, rectify: Rectifier, record: Recorder | None):
        self._settings, self._policy, self._rectify, self._record = settings, policy, rectify, record
        self._smooth = LowPass(1.0)
        self._number = self._crc = 0
        self._taken = self._steering = 0.0

    def look(self, shot: Shot) -> None:
        """Steers by a new picture.

        Raises UserError for a picture of another size than the calibration's, and for an answer that is no number or
        beyond what the policy was trained to give.
        """
        crc = binascii.crc32(shot.picture.data)
        answer = self._policy(self._rectify(shot.picture))
        limit = WILD * self._policy.info.steering_limit
        if not (isinstance(answer, float) and math.isfinite(answer) and abs(answer) <= limit):
            raise UserError(
                f"{self._settings.policy}: answers {answer} rad, beyond {limit:.3g}, to picture {shot.number}; "
                "it is not for this camera or damaged, export it again"
            )
        if self._record:
            self._record(shot, crc, answer)
        share = share_after(shot.taken - self._taken, self._settings.low_pass_seconds)
        smooth, most = self._smooth(answer, share), self._settings.steering_limit
        self._steering, self._crc, self._taken = min(max(smooth, -most), most), crc, shot.taken

    def command(self, state: bytes) -> bytes:
        """Returns the next command: steering by the last picture, and motion only where the guard's state allows it."""
        self._number += 1
        speed = float(self._settings.speed) if state == b"ARMED" else 0.0
        now = time.monotonic()
        return Command(self._number, self._crc, self._taken, now, self._steering, speed).packed()


def drive(camera: CameraSource, pilot: Pilot, link: GuardLink, first: Shot) -> None:
    """Sends a command for every new picture, and one every `LONGEST_WAIT` without; raises GuardGoneError at the end."""
    seen = first.number
    while True:
        shot = camera.wait(seen, LONGEST_WAIT)
        if shot is not None:
            seen = shot.number
            pilot.look(shot)
        link.send(pilot.command(link.listen()))


def steer(link: socket.socket, settings: PolicySettings) -> None:
    """Loads, tries and then drives until the guard goes; raises UserError for what the user can mend."""
    lens, policy = settings.calibration(), load_exported(settings.policy)
    if policy.info.channels != 3:
        raise UserError(
            f"{settings.policy}: reads depth as a fourth channel, which the car's camera does not give; "
            "export a policy that was trained without depth"
        )
    try:
        rectify = Rectifier(lens, policy.info)
    except UserError as error:
        raise UserError(f"{settings.policy}: {error}") from error
    recorder = None
    try:
        with open_camera(settings.camera, lens.device_width, lens.height) as camera:
            recorder = Recorder(Path(settings.record), lens) if settings.record else None
            first = camera.wait(0, 0.0)
            assert first is not None, "an open camera has given a picture"
            pilot = Pilot(settings, policy, rectify, recorder)
            pilot.look(first)
            guard = GuardLink(link)
            guard.send(READY)
            drive(camera, pilot, guard, first)
    except GuardGoneError:
        return
    finally:
        if recorder:
            recorder.close()
            if recorder.dropped:
                print(f"{settings.record}: {recorder.dropped} pictures were not recorded", file=sys.stderr)


def main(argv: list[str]) -> int:
    """Runs the process; `argv` is the number of the inherited socket and the settings as JSON."""
    for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGTSTP):  # keys go to all: the guard decides, and ends us
        signal.signal(number, signal.SIG_IGN)
    die_with_parent(signal.SIGKILL)
    cv2.setNumThreads(1)
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # what it has to say is in our own sentences
    if len(argv) != 2 or not argv[0].isdecimal():
        raise UserError("this process is started by the bridge: give the number of a socket and its settings as JSON")
    settings = PolicySettings.from_json(argv[1])
    try:
        link = socket.socket(fileno=int(argv[0]))
    except OSError as error:
        raise UserError(f"{argv[0]} is no socket ({error.strerror}); start this process through the bridge") from error
    with link:
        steer(link, settings)
    return 0


if __name__ == "__main__":
    run_main(lambda: main(sys.argv[1:]))
