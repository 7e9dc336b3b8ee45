"""The serial port: opened for this process alone, read without waiting, written within milliseconds or not at all."""

import contextlib
import errno
import fcntl
import os
import struct
import termios
from pathlib import Path

import serial
from serial.tools import list_ports

from hashnerf.errors import UserError

WRITE_SECONDS = 0.02
MOST_WAITING = 256
"""Bytes that may wait in the system for a controller that does not take them: a fifth of a second of set-points."""
STABLE_NAMES = Path("/dev/serial/by-id")


class LinkLost(Exception):
    """The port is gone."""


class LinkBlocked(Exception):
    """The port takes no more bytes."""


class SerialLink:
    """An open port."""

    def __init__(self, port: str):
        """Opens a port; raises UserError with a sentence on what to do where it cannot be."""
        try:
            self._serial = serial.Serial(port, 115200, timeout=0, write_timeout=WRITE_SECONDS, exclusive=True)
        except (OSError, ValueError, termios.error) as error:
            raise UserError(f"{port}: {_why(port, error)}") from error
        with contextlib.suppress(OSError):  # keeps out programs that do not ask for the lock, root's apart
            fcntl.ioctl(self._serial.fileno(), termios.TIOCEXCL)

    def fileno(self) -> int:
        """For select."""
        return self._serial.fileno()

    def read(self) -> bytes:
        """Returns what has arrived, maybe nothing; raises LinkLost."""
        try:
            return self._serial.read(4096)
        except (OSError, termios.error) as error:
            raise LinkLost(str(error)) from error

    def write(self, data: bytes) -> None:
        """Sends bytes; raises LinkBlocked where they are not taken in time, LinkLost where nobody is there."""
        try:
            if self._waiting() > MOST_WAITING:
                raise LinkBlocked(f"{self._waiting()} bytes wait")
            self._serial.write(data)
        except serial.SerialTimeoutException as error:
            raise LinkBlocked(str(error)) from error
        except (OSError, termios.error) as error:
            raise LinkLost(str(error)) from error

    def drop_waiting(self) -> None:
        """Forgets what waits to be sent: a controller that wakes up must not read old set-points."""
        try:
            self._serial.reset_output_buffer()
        except (OSError, termios.error) as error:
            raise LinkLost(str(error)) from error

    def close(self) -> None:
        """Closes the port."""
        self._serial.close()

    def _waiting(self) -> int:
        answer = fcntl.ioctl(self._serial.fileno(), termios.TIOCOUTQ, b"\0\0\0\0")
        return struct.unpack("i", answer)[0]


def _why(port: str, error: Exception) -> str:
    number = getattr(error, "errno", None)
    if number == errno.ENOENT or not os.path.exists(port):
        return f"there is no such port; plug the motor controller in and choose one of: {_choice()}"
    if number in (errno.EACCES, errno.EPERM):
        return "you may not use this port; add yourself to its group (sudo usermod -aG dialout $USER) and log in again"
    if number in (errno.EAGAIN, errno.EBUSY, errno.EWOULDBLOCK):
        return "another program uses this port; end it (VESC Tool, another bridge, ModemManager)"
    return f"this is no serial port; choose one of: {_choice()}"


def _choice() -> str:
    return ", ".join(stable_name(one.device) for one in list_ports.comports()) or "none"


def stable_name(port: str, names: Path = STABLE_NAMES) -> str:
    """Returns the name under which the system will find the same device again, whichever number it gets."""
    same = (one for one in sorted(names.glob("*")) if os.path.realpath(one) == os.path.realpath(port))
    return str(next(same, port))


def describe_candidates() -> list[str]:
    """Returns one line for every port: its stable name, the device and what it calls itself."""
    return [f"{stable_name(one.device)}  ({one.device}: {one.description})" for one in list_ports.comports()]
