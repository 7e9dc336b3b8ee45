"""The guard as a process: a loop of 20 ms over the port, the policy's socket, the operator and the signals.

python -m aerial2ground.guard.guard_process SETTINGS_JSON

Ends with 0 (quit, or standard input closed), 128 + the signal's number, 2 for a port that cannot be used, or as the
policy's process ended; always after the stop sequence.
"""

import contextlib
import json
import os
import signal
import socket
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.black_box import BlackBox
from aerial2ground.guard.guard import Guard, GuardSettings
from aerial2ground.guard.loop import Announcer, Loop
from aerial2ground.guard.operator_input import Datagrams, Joystick, Keyboard, StopFile
from aerial2ground.guard.priority import die_with_parent, end_child, prefer
from aerial2ground.guard.serial_link import stable_name
from hashnerf.errors import UserError

KEY, DATAGRAMS = "key", "datagrams"
SIGNALS = tuple(
    getattr(signal, f"SIG{name}")
    for name in ("INT", "TERM", "HUP", "QUIT", "TSTP", "USR1", "USR2", "ALRM", "VTALRM", "PROF", "XCPU")
)
"""All that would end or halt a process and can be caught: each stops the car first, Ctrl-Z as well."""
IGNORED = (signal.SIGTTOU, signal.SIGTTIN)
"""Sent to a process that is not in the foreground of its terminal: reading it fails then, and that ends us."""


@dataclass(frozen=True)
class ProcessSettings:
    """What `launch` hands over."""

    actuation: dict
    """Fields of the car's Actuation."""
    guard: dict
    """Fields of GuardSettings."""
    port: str = ""
    """Of the motor controller; empty: none is opened, nothing can be armed."""
    policy_socket: int = -1
    """Descriptor of the socket to the policy's process."""
    policy_process: int = -1
    """Its number."""
    log: str = "runs/bridge"
    """Folder of the black box."""
    dead_man: str = KEY
    """`key`, `datagrams`, or a joystick's button as /dev/input/js0:5."""
    operator: str = ""
    """HOST:PORT at which datagrams are taken for words; empty: none."""
    stop_file: str = ""
    """File whose appearance stops the car; empty: none."""


def main(argv: Sequence[str]) -> int:
    """Runs the guard; returns the exit code."""
    settings = ProcessSettings(**json.loads(argv[1]))
    die_with_parent(signal.SIGHUP)
    hurried = prefer()
    try:
        status = run_guard(settings, hurried)
    except UserError as error:
        end_child(settings.policy_process, 0.0)
        print(error, file=sys.stderr)
        return 2
    except BaseException:
        end_child(settings.policy_process, 0.0)
        raise
    ended = end_child(settings.policy_process, 1.0)
    if status == 0:
        return max(ended, 0)  # what the policy's process found wrong is said, though the operator has gone
    return status if status > 0 else ended or 1


def run_guard(settings: ProcessSettings, hurried: bool = True) -> int:
    """Runs the loop over what the settings name; returns the exit code, -1 where the policy's process decides.

    Raises UserError for a port, joystick, address or log that cannot be used.
    """
    actuation, guard_settings = Actuation(**settings.actuation), GuardSettings(**settings.guard)
    with contextlib.ExitStack() as stack:
        policy = stack.enter_context(socket.socket(fileno=settings.policy_socket))
        policy.setblocking(False)
        signals = stack.enter_context(signal_socket())
        announcer = Announcer(sys.stdout)
        stack.callback(announcer.close)
        inputs: list[Keyboard | Datagrams] = [Keyboard(sys.stdin.fileno(), settings.dead_man == KEY, announcer.echo)]
        stack.callback(inputs[0].close)  # whatever fails below, the terminal is given back
        if settings.operator:
            inputs.append(Datagrams(settings.operator, settings.dead_man == DATAGRAMS))
            stack.callback(inputs[1].close)
        polled: list[Keyboard | Joystick | StopFile] = [inputs[0]]
        if settings.dead_man not in (KEY, DATAGRAMS):
            polled.append(Joystick(settings.dead_man))
            stack.callback(polled[-1].close)
        if settings.stop_file:
            polled.append(StopFile(settings.stop_file))
        black_box = BlackBox(Path(settings.log))
        stack.callback(black_box.close)
        black_box.add({"actuation": settings.actuation, "guard": settings.guard})
        port = settings.port and stable_name(settings.port)
        loop = Loop(Guard(actuation, guard_settings), port, policy, inputs, polled, signals, black_box, announcer.say)
        loop.greeting = [f"black box: {settings.log}; process {os.getpid()}"]
        if not hurried:
            loop.greeting.append("no real-time priority (docs/deploy.md): on a busy computer expect GUARD_LATE")
        loop.greeting.append("say check, yes, arm, and hold the dead-man; space bar: emergency stop; quit ends")
        stack.callback(loop.close_link)
        return loop.run()


@contextlib.contextmanager
def signal_socket() -> Iterator[socket.socket]:
    """Gives a socket on which the number of every signal that asks us to end arrives as a byte."""
    reader, writer = socket.socketpair()
    reader.setblocking(False)
    writer.setblocking(False)
    wakeup = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    before = {number: signal.signal(number, lambda *_: None) for number in SIGNALS}
    before |= {number: signal.signal(number, signal.SIG_IGN) for number in IGNORED}
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)  # whoever started us may have blocked them
    try:
        yield reader
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(wakeup)
        reader.close()
        writer.close()


if __name__ == "__main__":
    sys.exit(main(sys.argv))
