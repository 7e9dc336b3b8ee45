"""The camera of a car in a CARLA server, read through the `carla` client in a process of its own.

The client is native code that can end its whole process: whatever else answers on the port makes it abort. So it never
runs in ours; a child process holds it and hands over pictures through a pipe, and every wait has an end. Written for
CARLA 0.9.16 against its documentation; it could not be tried against a live server.

Poses are in our frame: x forward, y left, z up, metres, yaw counter-clockwise from above and pitch upwards in radians.
CARLA's is left-handed with degrees: `carla_pose` converts.
"""

import contextlib
import importlib.util
import json
import math
import signal
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np
import torch
from jaxtyping import UInt8

from carff.carla_process import PICTURE, STOP, serve
from carff.decisions import decide_from_pictures
from carff.model import CarffModel
from carff.planner import Decision
from hashnerf.errors import UserError

PATIENCE = 5.0  # seconds that the child may need beyond the client's own timeout, mostly to start


@dataclass(frozen=True)
class CarlaConfig:
    """Where the camera is put in the CARLA server, and for how long."""

    timeout: float = 10.0
    """Seconds to wait for the server."""
    pose: tuple[float, float, float, float, float] = (0.0, 0.0, 1.6, 0.0, 0.0)
    """Camera: x, y, z in metres, yaw and pitch in radians (y to the left, yaw counter-clockwise)."""
    frames: int = 10
    """Pictures to decide from before ending."""

    def __post_init__(self):
        if not 0 < self.timeout < math.inf:
            raise UserError(f"carla.timeout is {self.timeout}; give a positive number of seconds")
        if not all(math.isfinite(value) for value in self.pose):
            raise UserError(f"carla.pose is {self.pose}; give five finite numbers")
        if self.frames < 1:
            raise UserError(f"carla.frames is {self.frames}; give at least 1")


def carla_pose(pose: tuple[float, float, float, float, float]) -> dict[str, float]:
    """Returns location (metres) and rotation (degrees) in CARLA's left-handed frame of a pose in ours."""
    x, y, z, yaw, pitch = pose
    return {"x": x, "y": -y, "z": z, "pitch": math.degrees(pitch), "yaw": -math.degrees(yaw), "roll": 0.0}


def field_of_view(focal: float, width: int) -> float:
    """Returns the horizontal field of view in degrees of a pinhole camera with a focal length in pixels."""
    return math.degrees(2 * math.atan(width / (2 * focal)))


class CarlaCamera:
    """A camera at a fixed pose in a running CARLA server; use it in a `with` statement.

    Raises UserError, one sentence, when the client package or the server is missing or the server stops answering.
    """

    def __init__(self, host: str, port: int, config: CarlaConfig, width: int, height: int, degrees: float):
        if not 0 < port < 65536:
            raise UserError(f"port is {port}; give a number from 1 to 65535")
        self.address, self.config = (host, port), config
        self.settings = {
            "host": host,
            "port": port,
            "timeout": config.timeout,
            "transform": carla_pose(config.pose),
            "attributes": {"image_size_x": str(width), "image_size_y": str(height), "fov": f"{degrees:.4f}"},
        }

    def __enter__(self) -> "CarlaCamera":
        require_client()
        self._require_listener()
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=serve, args=(theirs, self.settings), daemon=True)
        self._process.start()
        theirs.close()
        try:
            self.server_version = self._answer()["version"]
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        with contextlib.suppress(OSError):
            self._pipe.send_bytes(STOP)
            self._process.join(self.config.timeout)
        self._end()

    def picture(self) -> UInt8[np.ndarray, "h w 3"]:
        """Returns the next picture, RGB."""
        with contextlib.suppress(OSError):  # a child that has ended is reported by the missing answer
            self._pipe.send_bytes(PICTURE)
        shape = self._answer()["shape"]
        return np.frombuffer(self._pipe.recv_bytes(), np.uint8).reshape(shape).copy()

    def _answer(self) -> dict:
        where = "{}:{}".format(*self.address)
        if not self._pipe.poll(self.config.timeout + PATIENCE):
            raise UserError(f"the CARLA client does not answer within {self.config.timeout + PATIENCE:.0f} s ({where})")
        try:
            answer = json.loads(self._pipe.recv_bytes())
        except (EOFError, ConnectionError) as error:
            self._process.join(PATIENCE)
            ending = _ending(self._process.exitcode)
            raise UserError(
                f"the CARLA client ended by itself ({ending}): is {where} a CARLA server of the client's version?"
            ) from error
        if "error" in answer:
            raise UserError(f"no answer from a CARLA server at {where}: {answer['error']}")
        return answer

    def _require_listener(self) -> None:
        try:
            socket.create_connection(self.address, self.config.timeout).close()
        except OSError as error:
            where = "{}:{}".format(*self.address)
            raise UserError(
                f"no CARLA server listens at {where} ({error.strerror or error}); start one (CarlaUE4.sh) or give its "
                "--host and --port"
            ) from error

    def _end(self) -> None:
        if self._process.is_alive():
            self._process.kill()
        self._process.join()
        self._pipe.close()


def watch(model: CarffModel, host: str, port: int, config: CarlaConfig, samples: int, seed: int) -> Iterator[Decision]:
    """Yields a decision for each picture of the camera, made with the size and lens that the model learned."""
    cameras = model.scene.cameras
    ego = (model.scene.cameras_of("ego") or [0])[0]
    degrees = field_of_view(float(cameras.focal[ego, 0]), cameras.width)
    generator = torch.Generator().manual_seed(seed)
    with CarlaCamera(host, port, config, cameras.width, cameras.height, degrees) as camera:
        for _ in range(config.frames):
            picture = torch.from_numpy(camera.picture())[None]
            yield decide_from_pictures(model, picture, model.config.planner, samples, generator)[0]


def require_client() -> None:
    """Raises UserError when the `carla` package is not installed (it is looked for, not imported)."""
    if importlib.util.find_spec("carla") is None:
        raise UserError("the `carla` client package is not installed; install it with: pip install -e .[carla]")


def _ending(exit_code: int | None) -> str:
    if exit_code is not None and exit_code < 0:
        return f"signal {signal.Signals(-exit_code).name}"
    return f"exit status {exit_code}"
