"""Starts the two processes of the bridge: the policy's as a child, then this one becomes the guard.

The guard is the process that the operator started: it gets the terminal, the signals and the exit code.
"""

import contextlib
import itertools
import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NoReturn

from aerial2ground.bridge.car_file import CarFile, load_car
from hashnerf.errors import UserError

LIST = "list"


@dataclass(frozen=True)
class DeployConfig:
    """How a car is driven."""

    policy: str
    """ONNX file of scripts/export_policy.py."""
    port: str = ""
    """Serial port of the VESC; `list`, or nothing after it, lists the ports of this computer."""
    dry_run: bool = False
    """Open no port: look at what the policy would do."""
    car: Path = Path("configs/cars/f1tenth.yaml")
    """The car's file: gains, limits, camera."""
    camera: str = "0"
    """Number of a video device, a video file, or the address of a stream."""
    speed: float = 0.5
    """Nominal speed, m/s; 0 steers only."""
    low_pass_seconds: float = 0.144
    """Time constant of the low-pass of the steering; 0.144 is a share of 0.5 every 0.1 s."""
    dead_man: str = "key"
    """`key`: hold g; `/dev/input/js0:5`: a joystick's button; `datagrams`: only what comes to --operator."""
    operator: str = ""
    """HOST:PORT at which datagrams `held`, `released` and `estop` are taken; anybody who reaches it is the operator."""
    stop_file: str = ""
    """A file whose appearance is an emergency stop."""
    accept_esc_timeout: float = 0.0
    """Milliseconds of the controller's own timeout that you accept though they are over 250; .inf: none at all."""
    time_limit: float = 600.0
    """Seconds after which a drive ends."""
    log: Path = Path("runs/bridge")
    """Folder of the black boxes, one each start."""
    record: bool = False
    """Keep every picture that was driven by, so that the drive can be replayed to the bit."""

    def __post_init__(self):
        if not 0 <= self.speed <= 2:
            raise UserError(f"speed is {self.speed}; give 0 to 2 m/s")
        if self.accept_esc_timeout < 0:
            raise UserError(f"accept_esc_timeout is {self.accept_esc_timeout}; give milliseconds, or .inf")
        if not 0 < self.time_limit <= 3600:
            raise UserError(f"time_limit is {self.time_limit}; give seconds, at most 3600")
        if not 0 <= self.low_pass_seconds <= 10:
            raise UserError(f"low_pass_seconds is {self.low_pass_seconds}; give 0 to 10 seconds")
        if not self.camera:
            raise UserError("camera is empty; give a device's number, a video file or a stream's address")
        if self.dead_man == "datagrams" and not self.operator:
            raise UserError("dead_man is datagrams; say where they come to with --operator HOST:PORT")
        if self.port and self.dry_run:
            raise UserError("port and dry_run are both given; a dry run opens no port")
        if not self.port and not self.dry_run:
            raise UserError("port is not given; say --port DEVICE (--port alone lists them) or --dry_run true")


def normal_arguments(argv: Sequence[str]) -> list[str]:
    """Returns arguments as parse_config takes them: `--dry-run` has a value, `--port` alone lists, `-` is `_`."""
    arguments = []
    for index, word in enumerate(argv):
        option, equals, value = word.partition("=")
        plain = option.replace("-", "_").replace("__", "--", 1) if option.startswith("--") else option
        arguments.append(plain + equals + value)
        alone = index + 1 == len(argv) or argv[index + 1].startswith("--")
        if not equals and alone and plain in ("--port", "--dry_run", "--record"):
            arguments.append(LIST if plain == "--port" else "true")
    return arguments


def policy_command(config: DeployConfig, car: CarFile, log: Path) -> list[str]:
    """Returns the command of the policy's process, but for the number of its socket."""
    settings = {
        "policy": config.policy,
        "camera": config.camera,
        "lens": asdict(car.camera),
        "speed": config.speed,
        "steering_limit": car.actuation.steering_limit,
        "low_pass_seconds": config.low_pass_seconds,
        "record": str(log / "pictures") if config.record else "",
    }
    return [sys.executable, "-m", "aerial2ground.bridge.policy_process", "{socket}", json.dumps(settings)]


def guard_settings(config: DeployConfig, car: CarFile, log: Path) -> dict:
    """Returns what the guard's process is told, but for the policy's socket and process."""
    return {
        "actuation": asdict(car.actuation),
        "guard": {"accept_esc_timeout": config.accept_esc_timeout / 1000, "time_limit": config.time_limit},
        "port": config.port,
        "log": str(log),
        "dead_man": config.dead_man,
        "operator": config.operator,
        "stop_file": config.stop_file,
    }


def fill_standard_streams() -> None:
    """Opens what the caller has closed of the descriptors 0 to 2, before a socket or a port becomes one of them."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)


def launch(config: DeployConfig) -> NoReturn:
    """Starts both processes and does not return; raises UserError for what can be seen to be wrong before."""
    car = load_car(config.car)
    if config.speed > car.actuation.speed_limit:
        limit = car.actuation.speed_limit
        raise UserError(f"speed is {config.speed} m/s, over the speed_limit {limit} of {config.car}; give less")
    log = new_folder(config.log)
    become_guard(policy_command(config, car, log), guard_settings(config, car, log))


def new_folder(parent: Path) -> Path:
    """Makes a folder that nobody else has, named by the time; raises UserError where none can be made."""
    name = time.strftime("%Y%m%d-%H%M%S")
    try:
        parent.mkdir(parents=True, exist_ok=True)
        for number in itertools.count():
            folder = parent / (f"{name}-{number}" if number else name)
            with contextlib.suppress(FileExistsError):
                folder.mkdir()
                return folder
    except OSError as error:
        raise UserError(f"{parent}: no log can be kept there ({error.strerror}); give another --log") from error
    raise AssertionError("counting does not end")


def become_guard(policy: Sequence[str], settings: dict) -> NoReturn:
    """Starts the policy's command, in which `{socket}` stands for the number of its socket, and becomes the guard."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    command = [str(theirs.fileno()) if word == "{socket}" else word for word in policy]
    child = subprocess.Popen(command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL)
    theirs.close()
    ours.set_inheritable(True)
    told = settings | {"policy_socket": ours.fileno(), "policy_process": child.pid}
    os.execv(sys.executable, [sys.executable, "-m", "aerial2ground.guard.guard_process", json.dumps(told)])
