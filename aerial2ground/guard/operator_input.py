"""The operator's words and signs: keyboard or standard input, joystick, datagrams, and a file that stops the car.

Words come from standard input: `check`, `yes`, `no`, `arm`, `stop`, `quit`, each with Enter. The space bar is the
emergency stop, at once. The dead-man is one of: the key `g`, held down; a button of a joystick; datagrams.
"""

import contextlib
import os
import socket
import struct
import termios
import tty
from collections.abc import Callable

from hashnerf.errors import UserError

DEAD_MAN_KEY, E_STOP_KEY, ESCAPE, END_KEY, ERASE_KEYS = "g", " ", "\x1b", "\x04", "\b\x7f"
LONGEST_WORD, LONGEST_NAME = 16, 255
KEYS_AT_ONCE = 256
LOCAL_FLAGS = 3
"""Where tcgetattr has them."""
MOST_AT_ONCE = 100
"""Signs taken in one go, so that a sender that floods us does not hold up the loop."""
_JOYSTICK = struct.Struct("IhBB")
"""Time, value, kind, number: linux/joystick.h."""
_BUTTON, _INITIAL = 1, 0x80
_SIGNS = ("held", "released", "closed")
"""What is no word, whoever types it."""


class Keyboard:
    """Standard input, from a terminal or from a program; gives `closed` at its end."""

    def __init__(self, descriptor: int, dead_man: bool, echo: Callable[[str], None] = lambda text: None):
        """Reads from a descriptor; its key `g` is the dead-man only where it is said to be.

        A terminal does not show what is typed any more: `echo` is given the letters of words, to be shown.
        """
        self._dead_man = dead_man
        self._descriptor = _without_waiting(descriptor)
        self._word = ""
        self._escape = ""
        """What has come of the sequence that an arrow or another key sends."""
        self._saved = termios.tcgetattr(descriptor) if os.isatty(descriptor) else None
        if self._saved is not None:
            tty.setcbreak(self._descriptor, termios.TCSANOW)  # what was typed stays
        self._echo = echo if self._saved is not None else lambda text: None

    def fileno(self) -> int:
        """For select."""
        return self._descriptor

    def read(self) -> list[str]:
        """Returns the words that are whole; to be called when there is something to read."""
        try:
            data = os.read(self._descriptor, KEYS_AT_ONCE)
        except BlockingIOError:  # somebody else has read it
            return []
        except OSError:  # the terminal is gone
            data = b""
        words = [] if data else ["closed"]
        for key in data.decode("ascii", errors="replace"):
            words += self._press(key)
        return words

    def _press(self, key: str) -> list[str]:
        """What one key says."""
        if key == E_STOP_KEY:
            self._word, self._escape = "", ""
            return ["estop"]
        if self._escape:
            more = key in "[O" if self._escape == ESCAPE else not (key.isalpha() or key == "~")
            self._escape = self._escape + key if more else ""
        elif key == ESCAPE:
            self._escape = key
        elif key == DEAD_MAN_KEY:
            return ["held"] if self._dead_man else []
        elif key in "\r\n":
            return self._enter()
        elif key == END_KEY:
            return ["quit"]
        elif key in ERASE_KEYS:
            self._echo("\b \b" if self._word else "")
            self._word = self._word[:-1]
        elif key.isprintable() and len(self._word) < LONGEST_WORD:
            self._echo(key)
            self._word += key
        return []

    def _enter(self) -> list[str]:
        self._echo("\n")
        word, self._word = self._word.lower(), ""
        return [f"{word} (typed)" if word in _SIGNS else word] if word else []

    def poll(self) -> list[str]:
        """Keeps the terminal giving every key at once: a shell that stopped us and let us go on has changed it."""
        if self._saved is not None:
            with contextlib.suppress(termios.error):  # it is gone, which reading will tell
                if termios.tcgetattr(self._descriptor)[LOCAL_FLAGS] & termios.ICANON:
                    tty.setcbreak(self._descriptor, termios.TCSANOW)
        return []

    def close(self) -> None:
        """Gives the terminal back as it was."""
        if self._saved is not None:
            with contextlib.suppress(termios.error):
                termios.tcsetattr(self._descriptor, termios.TCSANOW, self._saved)
        os.close(self._descriptor)


def _without_waiting(descriptor: int) -> int:
    """The same input opened anew, so that reading it never waits, and nobody else's reading does differently."""
    try:
        return os.open(f"/proc/self/fd/{descriptor}", os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
    except OSError:  # a socket cannot be opened
        return os.dup(descriptor)


class Joystick:
    """A button of a joystick of Linux, `/dev/input/js0:5`: held while it is down, released when it is gone."""

    def __init__(self, name: str):
        """Opens it; raises UserError where there is none."""
        path, _, button = name.partition(":")
        if not button.isdecimal() or os.path.isdir(path) or os.path.isfile(path):
            raise UserError(f"--dead_man {name}: say which button of the joystick is the dead-man, as {path}:5")
        try:
            self._descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise UserError(f"{path}: no joystick can be read here ({error.strerror}); plug it in") from error
        self._button, self._down, self._gone = int(button), False, False

    def poll(self) -> list[str]:
        """Returns `held` while the button is down, `released` when it has come up."""
        was_down = self._down
        try:
            for _ in range(0 if self._gone else MOST_AT_ONCE):
                _, value, kind, number = _JOYSTICK.unpack(os.read(self._descriptor, _JOYSTICK.size))
                # after an overflow the system tells the state anew, as at the start: that may release, never press
                if kind & ~_INITIAL == _BUTTON and number == self._button:
                    self._down = bool(value) and (self._down or not kind & _INITIAL)
        except BlockingIOError:
            pass
        except (OSError, struct.error):  # unplugged, or at its end: nobody holds it any more
            self._gone, self._down = True, False
        if self._down:
            return ["held"]
        return ["released"] if was_down else []

    def close(self) -> None:
        """Closes it."""
        os.close(self._descriptor)


class Datagrams:
    """Words of one datagram each, for a remote control of one's own: `held`, `released`, `estop`."""

    def __init__(self, address: str, dead_man: bool):
        """Listens at HOST:PORT, for `held` only where it is the dead-man; raises UserError where it cannot."""
        self._words = ("held", "released", "estop") if dead_man else ("estop",)
        host, _, port = address.rpartition(":")
        if not host:
            raise UserError(f"--operator {address}: says no host, so anybody could be the operator; give HOST:PORT")
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((host, int(port)))
        except (OSError, ValueError, OverflowError) as error:
            self._socket.close()
            raise UserError(
                f"--operator {address}: cannot listen there ({error}); give HOST:PORT of this machine"
            ) from error

    @property
    def address(self) -> tuple[str, int]:
        """Host and port that it listens at."""
        return self._socket.getsockname()

    def fileno(self) -> int:
        """For select."""
        return self._socket.fileno()

    def read(self) -> list[str]:
        """Returns the words that have come; anything else is not for us."""
        words = []
        with contextlib.suppress(OSError):  # no more are there; a damaged one is readable until it is looked at
            for _ in range(MOST_AT_ONCE):
                word = self._socket.recv(64).decode("ascii", errors="replace")
                if word in self._words:
                    words.append(word)
        return words

    def close(self) -> None:
        """Stops listening."""
        self._socket.close()


class StopFile:
    """A file whose appearance is an emergency stop: `touch` it from anywhere."""

    def __init__(self, path: str):
        """Watches for a file; raises UserError where none could ever be made."""
        folder, name = os.path.split(os.path.abspath(path))
        if not os.path.isdir(folder) or len(os.fsencode(name)) > LONGEST_NAME:
            raise UserError(f"--stop_file {path}: no file can be made there; give a name in a folder that exists")
        self._path = path

    def poll(self) -> list[str]:
        """Returns `estop` as long as the file is there: until it is removed nothing can be armed."""
        return ["estop"] if os.path.lexists(self._path) else []

    def close(self) -> None:
        """Nothing to close."""
