"""The parent of the CARLA client's process: one sentence for everything that is missing, and no end of our own."""

import http.server
import math
import socket
import sys
import textwrap
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from carff import carla_client
from carff.carla_client import CarlaCamera, CarlaConfig, carla_pose, field_of_view, require_client, watch
from hashnerf.errors import UserError

QUICK = CarlaConfig(timeout=2.0, frames=2)


def fake_package(folder: Path, monkeypatch, client: str) -> None:
    """Puts a package `carla` on the path, of this process and of its children, whose Client does what `client` says."""
    (folder / "carla.py").write_text(textwrap.dedent(client))
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(sys.modules, "carla", raising=False)


@pytest.fixture
def foreign_server() -> Iterator[int]:
    """The port of a server on loopback that answers, but is none of CARLA's."""
    server = http.server.HTTPServer(("127.0.0.1", 0), http.server.BaseHTTPRequestHandler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield server.server_port
    server.shutdown()
    server.server_close()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def camera(port: int, config: CarlaConfig = QUICK) -> CarlaCamera:
    return CarlaCamera("127.0.0.1", port, config, 4, 2, 90.0)


def test_without_the_package_the_sentence_says_how_to_install_it(monkeypatch):
    monkeypatch.setattr(carla_client.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"not installed; install it with: pip install -e \.\[carla\]"):
        require_client()
    with pytest.raises(UserError, match="not installed"):
        camera(2000).__enter__()


def test_without_a_server_the_sentence_names_the_address(tmp_path, monkeypatch):
    fake_package(tmp_path, monkeypatch, "")
    port = free_port()
    with pytest.raises(UserError, match=rf"no CARLA server listens at 127\.0\.0\.1:{port} .*start one"):
        camera(port).__enter__()


def test_a_server_of_another_kind_is_no_end_of_ours(tmp_path, monkeypatch, foreign_server):
    # What the client does when it meets one, measured: a time-out first, and a little later it aborts its process.
    fake_package(
        tmp_path,
        monkeypatch,
        """
        import os, threading
        def Client(host, port):
            threading.Timer(0.05, os.abort).start()
            raise RuntimeError("time-out of 2000ms while waiting for the simulator")
        """,
    )
    with pytest.raises(UserError, match=f"no answer from a CARLA server at .*{foreign_server}: time-out of 2000ms"):
        camera(foreign_server).__enter__()


def test_an_abort_of_the_client_is_reported_with_its_signal(tmp_path, monkeypatch, foreign_server):
    fake_package(tmp_path, monkeypatch, "import os\ndef Client(host, port):\n    os.abort()\n")
    with pytest.raises(UserError, match=r"ended by itself \(signal SIGABRT\): is .* a CARLA server"):
        camera(foreign_server).__enter__()


def test_a_client_that_hangs_is_given_up(tmp_path, monkeypatch, foreign_server):
    fake_package(tmp_path, monkeypatch, "import time\ndef Client(host, port):\n    time.sleep(60)\n")
    monkeypatch.setattr(carla_client, "PATIENCE", 0.5)
    with pytest.raises(UserError, match="does not answer within"):
        camera(foreign_server, CarlaConfig(timeout=0.5)).__enter__()


WORKING = """
import types

class Camera:
    def listen(self, callback):
        import threading, time
        def shoot():
            for shade in range(200):
                callback(types.SimpleNamespace(height=32, width=32, raw_data=bytes([shade, 7, 9, 255]) * 1024))
                time.sleep(0.02)
        threading.Thread(target=shoot, daemon=True).start()
    def stop(self): pass
    def destroy(self): pass

class Client:
    def __init__(self, host, port): pass
    def set_timeout(self, seconds): pass
    def get_server_version(self): return "0.9.16"
    def get_world(self):
        find = lambda name: types.SimpleNamespace(set_attribute=lambda key, value: None)
        library = types.SimpleNamespace(find=find)
        return types.SimpleNamespace(get_blueprint_library=lambda: library, spawn_actor=lambda what, where: Camera())

def Location(**values): return values
def Rotation(**values): return values
def Transform(location, rotation): return (location, rotation)
"""


def test_pictures_arrive_and_are_decided_from(tmp_path, monkeypatch, foreign_server, tiny_evaluation):
    fake_package(tmp_path, monkeypatch, WORKING)
    seen: list[np.ndarray] = []
    known = tiny_evaluation.data.images[tiny_evaluation.table.views[2, 1]]  # the truck is there

    def decide(model, pictures, planner, n, generator):
        seen.append(pictures[0].numpy())
        return carff_decide(model, known[None], planner, n, generator)

    carff_decide = carla_client.decide_from_pictures
    monkeypatch.setattr(carla_client, "decide_from_pictures", decide)
    decisions = list(watch(tiny_evaluation.model, "127.0.0.1", foreign_server, QUICK, samples=10, seed=0))
    assert [one.go for one in decisions] == [False, False] and decisions[0].samples == 10
    assert seen[0].shape == (32, 32, 3) and (seen[0][:, :, :2] == [9, 7]).all()
    assert seen[1][0, 0, 2] > seen[0][0, 0, 2], "the second picture is a later one"


def test_poses_change_from_our_frame_to_carlas():
    # 3 m ahead, 2 m to the left, looking to the left (+90 degrees) and 30 degrees up:
    # CARLA's y points right, its yaw runs clockwise from above, its pitch upwards.
    place = carla_pose((3.0, 2.0, 1.6, math.pi / 2, math.pi / 6))
    assert place == pytest.approx({"x": 3.0, "y": -2.0, "z": 1.6, "yaw": -90.0, "pitch": 30.0, "roll": 0.0})
    # The viewing direction in CARLA's frame, (cp cy, cp sy, sp), is ours mirrored in y.
    yaw, pitch = math.radians(place["yaw"]), math.radians(place["pitch"])
    theirs = np.array([math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw), math.sin(pitch)])
    ours = np.array([0.0, math.cos(math.pi / 6), 0.5])
    assert theirs * [1, -1, 1] == pytest.approx(ours)


def test_field_of_view_of_a_focal_length():
    assert field_of_view(64.0, 128) == pytest.approx(90.0)  # tan 45 degrees = 64 / 64
    assert field_of_view(64.0 * math.sqrt(3), 128) == pytest.approx(60.0)  # tan 30 degrees = 1 / sqrt 3


@pytest.mark.parametrize(
    ("values", "key"),
    [({"timeout": 0.0}, "timeout"), ({"frames": 0}, "frames"), ({"pose": (0.0, 0.0, math.nan, 0.0, 0.0)}, "pose")],
)
def test_settings_are_checked(values, key):
    with pytest.raises(UserError, match=rf"carla\.{key}"):
        CarlaConfig(**values)


def test_the_port_is_checked():
    with pytest.raises(UserError, match="port is 70000"):
        camera(70000)
