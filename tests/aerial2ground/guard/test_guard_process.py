"""The guard's process, run in this one: with a real port, a policy's socket, signals, and a child."""

import json
import os
import pty
import runpy
import select
import signal
import socket
import struct
import sys
import termios
import threading
import time
from types import SimpleNamespace

import pytest

from aerial2ground.guard import guard_process, loop, priority
from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.guard_process import SIGNALS, ProcessSettings, main, run_guard, signal_socket
from hashnerf.errors import UserError
from tests.aerial2ground.guard.bench import ANSWER, FIRMWARE, taken_apart
from tests.aerial2ground.guard.place import PATIENCE, closed


def test_the_words_of_the_operator_end_it(place):
    os.write(place.keys, b"quit\n")
    threads = threading.active_count()
    assert run_guard(ProcessSettings(**place.settings())) == 0
    assert threading.active_count() == threads
    assert place.first_line() == {"actuation": {}, "guard": {}}
    assert closed(place.policy_socket)
    assert place.lines()[-1]["state"] == "DISARMED"


def test_what_it_was_told_is_the_first_line_of_the_log(place):
    os.write(place.keys, b"quit\n")
    told = {"actuation": {"speed_limit": 0.5}, "guard": {"time_limit": 5.0}}
    run_guard(ProcessSettings(**place.settings(**told)))
    assert place.first_line() == told


def test_the_cars_file_is_heeded(place):
    with pytest.raises(UserError, match="speed_limit is 3"):
        run_guard(ProcessSettings(**place.settings(actuation={"speed_limit": 3.0})))


def test_a_port_with_a_controller(place, capsys, monkeypatch):
    monkeypatch.setattr(loop, "FIRMWARE_SECONDS", PATIENCE)  # on a busy computer, too
    place.start(place.controller)
    place.policy.send(b"ready")

    def quit_later():
        # set-points go on after the one with which the timeout is measured
        place.wait_for(lambda: bytes.fromhex("02030c") in place.heard.partition(bytes.fromhex("0205060000000000"))[2])
        os.write(place.keys, b"hello\nquit\n")

    place.start(quit_later)
    assert run_guard(ProcessSettings(**place.settings(port=place.port))) == 0
    place.end_threads()
    frames = taken_apart(place.heard)
    assert [kind for kind, _ in frames[:1]] == [FIRMWARE] and (ANSWER, 0) in frames
    assert place.policy.recv(100) == b"DISARMED"
    said = capsys.readouterr().out
    assert "the motor controller has no timeout of its own, or does not tell\n" in said
    assert "'hello' is no command" in said and "no real-time priority" not in said
    assert not any(record["state"] == "ARMED" for record in place.lines())


def test_r27_a_port_that_echoes_is_no_controller(place, bridge_row):
    def echo():
        while not place._ends.is_set():
            if select.select([place.master], [], [], 0.02)[0]:
                os.write(place.master, os.read(place.master, 4096))

    place.start(echo)
    with pytest.raises(UserError, match=f"^{place.port}: nothing there answers as a VESC does"):
        run_guard(ProcessSettings(**place.settings(port=place.port)))
    motion = sum(record["state"] != "DISARMED" for record in place.lines())
    bridge_row("R27", "a port that echoes: cycles in which the car is not disarmed", motion, 0)


@pytest.mark.parametrize("number", SIGNALS)
def test_r13_every_signal_ends_it(place, number, bridge_row):
    def kill():
        place.wait_for(lambda: (place.folder / "log.jsonl").exists())
        os.kill(os.getpid(), number)

    place.start(kill)
    status = run_guard(ProcessSettings(**place.settings()))
    bridge_row("R13", f"{number.name}: ends with another number than 128 and its own", status != 128 + number, 0)


def test_standard_input_that_ends(place):
    os.close(place.keys)
    assert run_guard(ProcessSettings(**place.settings())) == 0


def test_a_policy_that_ends_decides(place):
    place.policy.close()
    assert run_guard(ProcessSettings(**place.settings())) == -1


def test_the_terminal_is_given_back_whatever_happens(place, monkeypatch):
    ours, theirs = pty.openpty()
    before = termios.tcgetattr(theirs)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(fileno=lambda: theirs))
    with pytest.raises(UserError, match="says no host"):
        run_guard(ProcessSettings(**place.settings(operator="nowhere")))
    assert termios.tcgetattr(theirs) == before
    os.close(ours)
    os.close(theirs)


def fault_of(place, **settings) -> list:
    """Runs the guard until its log names a fault; returns everything that it took in."""

    def watch():
        place.wait_for(lambda: "estop" in text(place) or "held" in text(place))
        os.write(place.keys, b"quit\n")

    place.start(watch)
    assert run_guard(ProcessSettings(**place.settings(**settings))) == 0
    return [one[1:] for record in place.lines() for one in record["in"]]


def text(place) -> str:
    """The log."""
    log = place.folder / "log.jsonl"
    return log.read_text() if log.exists() else ""


def test_the_key_is_the_dead_man(place):
    os.write(place.keys, b"g")
    assert ["word", "held"] in fault_of(place)


def test_a_file_that_stops(place, tmp_path):
    (tmp_path / "estop").touch()
    assert ["word", "estop"] in fault_of(place, stop_file=str(tmp_path / "estop"))


@pytest.mark.parametrize(("dead_man", "word"), [("key", "estop"), ("datagrams", "held")])
def test_datagrams_of_the_operator(place, monkeypatch, dead_man, word):
    opened = []
    real = guard_process.Datagrams

    class Datagrams(real):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            opened.append(self)

    monkeypatch.setattr(guard_process, "Datagrams", Datagrams)

    def send():
        place.wait_for(lambda: opened)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for data in (b"held", word.encode()):
                sender.sendto(data, opened[0].address)

    place.start(send)
    taken = fault_of(place, operator="127.0.0.1:0", dead_man=dead_man)
    assert ["word", word] in taken
    assert (["word", "held"] in taken) == (dead_man == "datagrams")
    assert opened[0].fileno() == -1


def test_a_joystick_is_the_dead_man(place, tmp_path):
    os.mkfifo(tmp_path / "js0")
    reader = os.open(tmp_path / "js0", os.O_RDONLY | os.O_NONBLOCK)
    writer = os.open(tmp_path / "js0", os.O_WRONLY)
    os.write(writer, struct.pack("IhBB", 0, 1, 1, 3))
    os.write(place.keys, b"g")  # which is nothing then
    before = len(os.listdir("/proc/self/fd"))
    taken = fault_of(place, dead_man=f"{tmp_path / 'js0'}:3")
    assert len(os.listdir("/proc/self/fd")) == before - 1  # the policy's socket, and nothing is left open
    assert taken.count(["word", "held"]) == sum(
        ["word", "held"] in [one[1:] for one in record["in"]] for record in place.lines()
    )
    for descriptor in (reader, writer):
        os.close(descriptor)


def test_a_joystick_that_is_not_there(place, tmp_path):
    with pytest.raises(UserError, match="no joystick can be read here"):
        run_guard(ProcessSettings(**place.settings(dead_man=f"{tmp_path / 'js0'}:3")))


def argument(place, **changed) -> list[str]:
    """The command line."""
    return ["guard_process", json.dumps(place.settings(**changed))]


def ended_child(code: int) -> int:
    """A child that ends with a code."""
    return os.posix_spawnp("sh", ["sh", "-c", f"exit {code}"], os.environ)


def test_main_waits_for_the_child_and_ends_with_its_own_status(place):
    os.write(place.keys, b"quit\n")
    child = ended_child(0)
    assert main(argument(place, policy_process=child)) == 0
    assert place.prepared == [signal.SIGHUP, "prefer"]
    with pytest.raises(ChildProcessError):
        os.waitpid(child, os.WNOHANG)


@pytest.mark.parametrize(("code", "status"), [(3, 3), (0, 1)])
def test_main_ends_as_the_policy_did(place, code, status):
    place.policy.close()
    assert main(argument(place, policy_process=ended_child(code))) == status


def test_main_without_a_child(place):
    place.policy.close()
    assert main(argument(place)) == 1


def test_r27_main_says_what_is_wrong_and_ends_the_child(place, capsys, bridge_row):
    child = os.posix_spawnp("sleep", ["sleep", "60"], os.environ)
    begun = time.monotonic()
    assert main(argument(place, port=str(place.folder / "none"), policy_process=child)) == 2
    said = capsys.readouterr()
    assert "there is no such port; plug the motor controller in" in said.err and "Traceback" not in said.err
    with pytest.raises(ChildProcessError):
        os.waitpid(child, os.WNOHANG)
    bridge_row("R27", "a port that is not there: seconds to the end", time.monotonic() - begun, 2.0, "s")


def test_a_child_that_hangs_is_given_a_second(place, monkeypatch):
    asked = []
    monkeypatch.setattr(guard_process, "end_child", lambda *what: asked.append(what) or -9)
    place.policy.close()
    assert main(argument(place, policy_process=77)) == -9
    assert asked == [(77, 1.0)]


def test_an_error_ends_the_child_at_once(place, monkeypatch):
    asked = []
    monkeypatch.setattr(guard_process, "end_child", lambda *what: asked.append(what) or 0)
    assert main(argument(place, actuation={"speed_limit": 3.0}, policy_process=77)) == 2
    assert asked == [(77, 0.0)]


def test_the_defaults_open_nothing():
    settings = ProcessSettings({}, {})
    assert (settings.port, settings.policy_socket, settings.policy_process, settings.log) == ("", -1, -1, "runs/bridge")
    assert (settings.dead_man, settings.operator, settings.stop_file) == ("key", "", "")


def test_signals_arrive_as_bytes_and_everything_is_put_back():
    before = {number: signal.getsignal(number) for number in (*SIGNALS, signal.SIGTTOU)}
    with signal_socket() as reader:
        assert signal.getsignal(signal.SIGTTOU) is signal.SIG_IGN
        for number in SIGNALS:
            os.kill(os.getpid(), number)
            assert select.select([reader], [], [], PATIENCE)[0]
            assert reader.recv(1)[0] == number
        with pytest.raises(BlockingIOError):
            reader.recv(1)
        ours = signal.set_wakeup_fd(-1)
        assert not os.get_blocking(ours)
        signal.set_wakeup_fd(ours, warn_on_full_buffer=False)
    assert {number: signal.getsignal(number) for number in before} == before
    assert signal.set_wakeup_fd(-1) == -1
    assert closed(ours) and reader.fileno() == -1


def test_the_car_is_that_of_the_settings(place, monkeypatch):
    made = []

    def made_loop(guard, port, *_):
        made.append((guard, port))
        return SimpleNamespace(run=lambda: 5, close_link=lambda: made.append("closed"))

    monkeypatch.setattr(guard_process, "Loop", made_loop)
    monkeypatch.setattr(guard_process, "stable_name", lambda port: f"stable {port}")
    told = {"actuation": {"brake_current": 20.0}, "guard": {"time_limit": 7.0, "accept_esc_timeout": 1.0}, "port": "x"}
    assert run_guard(ProcessSettings(**place.settings(**told))) == 5
    guard, port = made[0]
    assert guard._car == Actuation(brake_current=20.0) and guard._settings.time_limit == 7.0
    assert port == "stable x" and made[1] == "closed"


def test_it_is_a_program(place, monkeypatch):
    monkeypatch.setattr(priority, "prefer", lambda: True)
    monkeypatch.setattr(priority, "die_with_parent", lambda number: None)
    monkeypatch.setattr(sys, "argv", argument(place))
    monkeypatch.delitem(sys.modules, "aerial2ground.guard.guard_process")
    os.write(place.keys, b"quit\n")
    with pytest.raises(SystemExit) as ended:
        runpy.run_module("aerial2ground.guard.guard_process", run_name="__main__")
    assert ended.value.code == 0


@pytest.mark.parametrize(("code", "status"), [(2, 2), (0, 0)])
def test_what_the_policy_found_wrong_is_told_though_the_operator_has_gone(place, code, status):
    os.write(place.keys, b"quit\n")
    assert main(argument(place, policy_process=ended_child(code))) == status


@pytest.mark.parametrize("hurried", [True, False])
def test_the_operator_is_greeted_when_all_is_there(place, capsys, hurried):
    place.policy.send(b"ready")
    place.start(lambda: (time.sleep(0.3), os.write(place.keys, b"check\nquit\n")))
    assert run_guard(ProcessSettings(**place.settings()), hurried) == 0
    place.end_threads()
    said = capsys.readouterr().out
    assert f"black box: {place.folder}; process {os.getpid()}\n" in said
    assert ("no real-time priority" in said) is not hurried
    assert "say check, yes, arm" in said
    assert "no motor controller is connected: no wheel can turn\n" in said


def test_signals_that_somebody_blocked_are_heard(place):
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])
    try:
        place.start(lambda: (time.sleep(0.3), os.kill(os.getpid(), signal.SIGTERM)))
        assert run_guard(ProcessSettings(**place.settings())) == 143
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])
        place.end_threads()


def test_an_error_of_the_program_ends_the_child_and_is_shown(place, monkeypatch):
    asked = []
    monkeypatch.setattr(guard_process, "end_child", lambda *what: asked.append(what) or 0)
    monkeypatch.setattr(guard_process, "run_guard", lambda *what: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        main(argument(place, policy_process=77))
    assert asked == [(77, 0.0)]
    os.close(place.policy_socket)
