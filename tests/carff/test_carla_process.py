"""The process that holds the `carla` client, tried with a stand-in for the package."""

import json
import sys
import types
from multiprocessing import Pipe

import numpy as np
import pytest

from carff.carla_process import PICTURE, STOP, serve

SETTINGS = {
    "host": "localhost",
    "port": 2000,
    "timeout": 0.2,
    "transform": {"x": 1.0, "y": -2.0, "z": 1.5, "pitch": 3.0, "yaw": -90.0, "roll": 0.0},
    "attributes": {"image_size_x": "4", "image_size_y": "2", "fov": "80.0"},
}


class FakeCarla(types.ModuleType):
    """A server that answers at once: its camera shows blue 1, green 2, red 3, alpha 255 everywhere."""

    def __init__(self, silent: bool = False, failure: Exception | None = None):
        super().__init__("carla")
        self.silent, self.failure = silent, failure
        self.attributes: dict[str, str] = {}
        self.calls: list[str] = []
        self.place = None

    def Client(self, host, port):
        if self.failure is not None:
            raise self.failure
        return types.SimpleNamespace(
            set_timeout=lambda seconds: None, get_server_version=lambda: "0.9.16", get_world=lambda: self.world()
        )

    def world(self):
        blueprint = types.SimpleNamespace(set_attribute=self.attributes.__setitem__)
        library = types.SimpleNamespace(find=lambda name: blueprint if name == "sensor.camera.rgb" else None)
        return types.SimpleNamespace(get_blueprint_library=lambda: library, spawn_actor=self.spawn)

    def spawn(self, blueprint, transform):
        self.place = transform
        ends = {name: lambda name=name: self.calls.append(name) for name in ("stop", "destroy")}
        return types.SimpleNamespace(listen=self.listen, **ends)

    def listen(self, callback):
        if not self.silent:
            raw = np.tile(np.array([1, 2, 3, 255], np.uint8), 8).tobytes()
            for _ in range(3):
                callback(types.SimpleNamespace(height=2, width=4, raw_data=raw))

    def Location(self, **values):
        return values

    def Rotation(self, **values):
        return values

    def Transform(self, location, rotation):
        return location | rotation


class Talk:
    """The parent's end of the pipe, with all requests sent before the child starts."""

    def __init__(self, *requests: bytes):
        self.parent, self.child = Pipe()
        for request in requests:
            self.parent.send_bytes(request)

    def answer(self) -> dict:
        return json.loads(self.parent.recv_bytes())


def test_version_picture_and_end(monkeypatch):
    fake = FakeCarla()
    monkeypatch.setitem(sys.modules, "carla", fake)
    talk = Talk(STOP)
    serve(talk.child, SETTINGS)
    assert talk.answer() == {"version": "0.9.16"}
    assert fake.attributes == SETTINGS["attributes"] and fake.place == SETTINGS["transform"]
    assert fake.calls == ["stop", "destroy"], "the camera is taken out of the world again"


def test_pictures_are_newer_than_the_request_and_rgb(monkeypatch):
    fake = FakeCarla()
    monkeypatch.setitem(sys.modules, "carla", fake)
    monkeypatch.setattr("carff.carla_process.queue.Queue.empty", lambda self: True)  # nothing is older here
    talk = Talk(PICTURE, STOP)
    serve(talk.child, SETTINGS)
    talk.answer()
    assert talk.answer() == {"shape": [2, 4, 3]}
    picture = np.frombuffer(talk.parent.recv_bytes(), np.uint8).reshape(2, 4, 3)
    assert (picture == [3, 2, 1]).all()


def test_old_pictures_are_dropped_and_silence_ends(monkeypatch):
    fake = FakeCarla()  # three pictures, all older than the request
    monkeypatch.setitem(sys.modules, "carla", fake)
    talk = Talk(PICTURE)
    serve(talk.child, SETTINGS)
    talk.answer()
    assert talk.answer() == {"error": "no picture for 0 s"}
    assert fake.calls == ["stop", "destroy"]


@pytest.mark.parametrize("failure", [RuntimeError("time-out of 1000ms"), ImportError("libomp is missing")])
def test_failures_of_the_client_become_a_sentence(monkeypatch, failure):
    monkeypatch.setitem(sys.modules, "carla", FakeCarla(failure=failure))
    talk = Talk()
    serve(talk.child, SETTINGS)
    assert talk.answer() == {"error": str(failure)}


def test_the_process_ends_when_nobody_listens_any_more(monkeypatch):
    fake = FakeCarla()
    monkeypatch.setitem(sys.modules, "carla", fake)
    talk = Talk()
    talk.parent.close()
    serve(talk.child, SETTINGS)  # returns
    assert fake.calls == ["stop", "destroy"]
