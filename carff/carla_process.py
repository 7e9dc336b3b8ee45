"""The child process of `carff.carla_client`: the only code that touches the `carla` client.

It announces {"version"} through the pipe, then answers each PICTURE with {"shape"} and the bytes of an RGB picture,
until STOP. What goes wrong is one {"error"}. Nothing heavy is imported here, so that the process starts at once.
"""

import contextlib
import json
import queue
import signal
from collections.abc import Iterator
from multiprocessing.connection import Connection

import numpy as np

STOP, PICTURE = b"stop", b"picture"


def serve(pipe: Connection, settings: dict) -> None:
    """The child process: holds the client, announces the server's version, then sends a picture per request."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    try:
        with _spawned_camera(settings) as (version, pictures):
            pipe.send_bytes(json.dumps({"version": version}).encode())
            while pipe.recv_bytes() != STOP:
                while not pictures.empty():
                    pictures.get_nowait()  # older than the request
                height, width, bgra = pictures.get(timeout=settings["timeout"])
                rgb = np.frombuffer(bgra, np.uint8).reshape(height, width, 4)[:, :, [2, 1, 0]]
                pipe.send_bytes(json.dumps({"shape": rgb.shape}).encode())
                pipe.send_bytes(rgb.tobytes())
    except queue.Empty:
        pipe.send_bytes(json.dumps({"error": f"no picture for {settings['timeout']:.0f} s"}).encode())
    except (RuntimeError, ImportError) as error:  # what the client raises for everything
        pipe.send_bytes(json.dumps({"error": str(error) or type(error).__name__}).encode())
    except (EOFError, ConnectionError):
        return  # the parent has gone


@contextlib.contextmanager
def _spawned_camera(settings: dict) -> Iterator[tuple[str, queue.Queue]]:
    import carla

    client = carla.Client(settings["host"], settings["port"])
    client.set_timeout(settings["timeout"])
    version = client.get_server_version()
    world = client.get_world()
    blueprint = world.get_blueprint_library().find("sensor.camera.rgb")
    for name, value in settings["attributes"].items():
        blueprint.set_attribute(name, value)
    place = settings["transform"]
    location = carla.Location(x=place["x"], y=place["y"], z=place["z"])
    rotation = carla.Rotation(pitch=place["pitch"], yaw=place["yaw"], roll=place["roll"])
    camera = world.spawn_actor(blueprint, carla.Transform(location, rotation))
    pictures: queue.Queue = queue.Queue()
    try:
        camera.listen(lambda image: pictures.put((image.height, image.width, bytes(image.raw_data))))
        yield version, pictures
    finally:
        camera.stop()
        camera.destroy()
