"""The port: a pseudo terminal that is read, filled up, unplugged, or that is no port at all."""

import errno
import fcntl
import os
import select
import struct
import termios
import time
import tty
from types import SimpleNamespace

import pytest
import serial

from aerial2ground.guard import serial_link
from aerial2ground.guard.serial_link import (
    MOST_WAITING,
    WRITE_SECONDS,
    LinkBlocked,
    LinkLost,
    SerialLink,
    describe_candidates,
    stable_name,
)
from hashnerf.errors import UserError


class Port:
    """A pseudo terminal; `master` is the controller's end."""

    def __init__(self):
        self.master, slave = os.openpty()
        tty.setraw(self.master)
        self.name = os.ttyname(slave)
        self._ends = {self.master, slave}

    def unplug(self) -> None:
        """Closes both ends."""
        for end in self._ends:
            os.close(end)
        self._ends = set()


@pytest.fixture
def port():
    """A port."""
    made = Port()
    yield made
    made.unplug()


@pytest.fixture
def link(port):
    """An open link to it."""
    opened = SerialLink(port.name)
    yield opened
    opened.close()


def test_bytes_go_both_ways_unchanged(port, link):
    every = bytes(range(256))
    link.write(every)
    assert read_all(port.master, 256) == every
    os.write(port.master, every)
    found = b""
    while len(found) < 256:
        assert select.select([link], [], [], 10)[0]
        found += link.read()
    assert found == every
    assert link.read() == b""


def read_all(descriptor: int, size: int) -> bytes:
    """So many bytes."""
    found = b""
    while len(found) < size:
        assert select.select([descriptor], [], [], 10)[0]
        found += os.read(descriptor, size)
    return found


def test_r27_a_port_is_ours_alone(port, link, bridge_row):
    with pytest.raises(UserError, match="another program uses this port; end it"):
        SerialLink(port.name)
    bridge_row("R27", "ports that two programs may use", 0, 0)
    link.close()
    SerialLink(port.name).close()


def test_the_ports_settings(link):
    assert link._serial.baudrate == 115200
    assert link._serial.timeout == 0
    assert link._serial.write_timeout == WRITE_SECONDS == 0.02
    assert MOST_WAITING == 256


@pytest.mark.parametrize("kind", ["missing", "file", "null", "folder"])
def test_r27_what_is_no_port(tmp_path, kind, bridge_row):
    (tmp_path / "file").write_text("")
    name = {"missing": tmp_path / "none", "file": tmp_path / "file", "null": "/dev/null", "folder": tmp_path}[kind]
    said = "there is no such port; plug the" if kind == "missing" else "this is no serial port; choose one of: "
    begun = time.monotonic()
    with pytest.raises(UserError, match=f"^{name}: {said}"):
        SerialLink(str(name))
    bridge_row("R27", f"{kind}: seconds until it is refused", time.monotonic() - begun, 2.0, "s")


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (errno.ENOENT, "there is no such port; plug the motor controller in and choose one of: none"),
        (errno.EACCES, "you may not use this port; add yourself to its group"),
        (errno.EPERM, "you may not use this port"),
        (errno.EAGAIN, "another program uses this port"),
        (errno.EBUSY, "another program uses this port"),
        (errno.EIO, "this is no serial port; choose one of: none"),
    ],
)
def test_every_reason_for_which_a_port_is_not_opened(monkeypatch, port, number, said):
    def refuse(*_, **__):
        raise serial.SerialException(number, os.strerror(number))

    monkeypatch.setattr(serial_link.serial, "Serial", refuse)
    monkeypatch.setattr(serial_link.list_ports, "comports", lambda: [])
    with pytest.raises(UserError, match=f"^{port.name}: {said}"):
        SerialLink(port.name)


@pytest.mark.parametrize("error", [termios.error(25, "no"), ValueError("scheme")])
def test_errors_of_every_kind_become_a_sentence(monkeypatch, port, error):
    def refuse(*_, **__):
        raise error

    monkeypatch.setattr(serial_link.serial, "Serial", refuse)
    with pytest.raises(UserError, match="this is no serial port"):
        SerialLink(port.name)


def test_the_candidates_are_named(monkeypatch, tmp_path):
    (tmp_path / "ttyACM0").write_text("")
    ports = [
        SimpleNamespace(device=str(tmp_path / "ttyACM0"), description="VESC"),
        SimpleNamespace(device="b", description="n/a"),
    ]
    monkeypatch.setattr(serial_link.list_ports, "comports", lambda: ports)
    assert describe_candidates() == [f"{tmp_path}/ttyACM0  ({tmp_path}/ttyACM0: VESC)", "b  (b: n/a)"]
    with pytest.raises(UserError, match=f"choose one of: {tmp_path}/ttyACM0, b$"):
        SerialLink(str(tmp_path / "none"))


def test_r17_the_port_is_unplugged(port, link, bridge_row):
    port.unplug()
    said = 0
    for call in (link.read, lambda: link.write(b"x"), lambda: link.write(b"")):
        with pytest.raises(LinkLost):
            call()
        said += 1
    bridge_row("R17", "calls that do not say that the port is gone", 3 - said, 0)


def test_termios_may_complain_too(link, monkeypatch):
    def complain(*_):
        raise termios.error(5, "Input/output error")

    monkeypatch.setattr(link._serial, "read", complain)
    monkeypatch.setattr(link._serial, "write", complain)
    monkeypatch.setattr(link._serial, "reset_output_buffer", complain)
    for call in (link.read, lambda: link.write(b"x"), link.drop_waiting):
        with pytest.raises(LinkLost, match="Input/output error"):
            call()


def test_x3_nobody_reads(link, bridge_row):
    longest, written = 0.0, 0
    with pytest.raises(LinkBlocked):
        while written < 10_000_000:
            begun = time.monotonic()
            try:
                link.write(bytes(200))
            finally:
                longest = max(longest, time.monotonic() - begun)
            written += 200
    bridge_row("X3", "bytes that nobody reads and that are waited for", written, 100_000, "bytes")
    assert longest >= WRITE_SECONDS


def test_what_waits_is_forgotten(port, link):
    link.drop_waiting()
    with pytest.raises(LinkBlocked):
        while True:
            link.write(bytes(1000))
    link.drop_waiting()
    link.write(b"new")  # there is room again


@pytest.mark.parametrize(("waiting", "blocked"), [(0, False), (256, False), (257, True), (70_000, True)])
def test_a_full_buffer_of_the_system_is_a_blocked_port(link, monkeypatch, waiting, blocked):
    asked = []

    def answer(descriptor, request, argument):
        asked.append((descriptor, request, len(argument)))
        return struct.pack("i", waiting)

    monkeypatch.setattr(serial_link, "fcntl", SimpleNamespace(ioctl=answer))
    if blocked:
        with pytest.raises(LinkBlocked, match=f"{waiting} bytes wait"):
            link.write(b"x")
    else:
        link.write(b"x")
    assert asked[0] == (link.fileno(), termios.TIOCOUTQ, 4)
    assert fcntl.ioctl(link.fileno(), termios.TIOCOUTQ, b"\0\0\0\0") is not None


def test_names_that_stay(tmp_path):
    (tmp_path / "dev").mkdir()
    names = tmp_path / "by-id"
    for number in (0, 1):
        (tmp_path / "dev" / f"ttyACM{number}").write_text("")
    assert stable_name(str(tmp_path / "dev" / "ttyACM0"), names) == str(tmp_path / "dev" / "ttyACM0")
    names.mkdir()
    (names / "usb-b").symlink_to("../dev/ttyACM1")
    (names / "usb-c").symlink_to("../dev/ttyACM1")
    (names / "usb-a").symlink_to("../dev/ttyACM0")
    assert stable_name(str(tmp_path / "dev" / "ttyACM1"), names) == str(names / "usb-b")
    assert stable_name(str(tmp_path / "dev" / "ttyACM0"), names) == str(names / "usb-a")
    assert stable_name(str(names / "usb-b"), names) == str(names / "usb-b")
    assert stable_name(str(tmp_path / "dev" / "ttyACM2"), names) == str(tmp_path / "dev" / "ttyACM2")
    assert str(serial_link.STABLE_NAMES) == "/dev/serial/by-id"


def test_r18_the_same_device_is_found_under_another_number(tmp_path, bridge_row):
    old, new = Port(), Port()
    name = tmp_path / "usb-vesc"
    name.symlink_to(old.name)
    chosen = stable_name(old.name, tmp_path)
    link = SerialLink(chosen)
    old.unplug()
    with pytest.raises(LinkLost):
        link.read()
    link.close()
    name.unlink()
    name.symlink_to(new.name)
    link = SerialLink(chosen)
    os.write(new.master, b"back")
    assert select.select([link], [], [], 10)[0]
    bridge_row("R18", "bytes of the device behind a swapped link that are missing", 4 - len(link.read()), 0)
    link.close()
    new.unplug()


def test_programs_that_do_not_ask_for_the_lock_are_kept_out_too():
    master, slave = os.openpty()
    link = SerialLink(os.ttyname(slave))
    answer = fcntl.ioctl(slave, 0x80045440, b"\0\0\0\0")  # TIOCGEXCL, which Python does not name
    assert struct.unpack("i", answer)[0] == 1
    link.close()
    os.close(master)
    os.close(slave)
