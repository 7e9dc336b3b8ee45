"""What the operator says, through real pipes, terminals and sockets."""

import os
import pty
import select
import socket
import struct
import termios

import pytest

from aerial2ground.guard.operator_input import MOST_AT_ONCE, Datagrams, Joystick, Keyboard, StopFile
from hashnerf.errors import UserError


@pytest.fixture
def keys():
    """A pipe to type into."""
    reader, writer = os.pipe()
    yield reader, lambda words: os.write(writer, words)
    os.close(reader)
    os.close(writer)


def test_words_and_signs(keys):
    reader, typing = keys
    keyboard = Keyboard(reader, True)
    typing(b"arm\n")
    assert keyboard.read() == ["arm"]
    typing(b"ggg")
    assert keyboard.read() == ["held"] * 3
    typing(b"che")
    assert keyboard.read() == []
    typing(b"ck\r\nyes\n\n")
    assert keyboard.read() == ["check", "yes"]
    keyboard.close()


def test_the_space_bar_stops_at_once_and_forgets_what_was_typed(keys):
    reader, typing = keys
    keyboard = Keyboard(reader, True)
    typing(b"ar m\n")
    assert keyboard.read() == ["estop", "m"]
    typing(b" ")
    assert keyboard.read() == ["estop"]
    keyboard.close()


def test_the_key_is_the_dead_man_only_where_it_is_said_to_be(keys):
    reader, typing = keys
    keyboard = Keyboard(reader, False)
    typing(b"gggstop\ng ")
    assert keyboard.read() == ["stop", "estop"]
    keyboard.close()


@pytest.mark.parametrize("dead_man", [True, False])
def test_signs_are_no_words(keys, dead_man):
    reader, typing = keys
    keyboard = Keyboard(reader, dead_man)
    typing(b"held\nreleased\nclosed\n")
    assert keyboard.read() == ["held (typed)", "released (typed)", "closed (typed)"]
    keyboard.close()


def test_long_words_are_cut_and_odd_bytes_do_no_harm(keys):
    reader, typing = keys
    keyboard = Keyboard(reader, True)
    typing(b"0123456789abcdefh" * 9 + b"\nar\x00\x01\tm\n\xff\n")
    assert keyboard.read() == ["0123456789abcdef", "arm", "�"]
    keyboard.close()


def test_words_are_mended_as_in_any_terminal(keys):
    reader, typing = keys
    keyboard = Keyboard(reader, True)
    typing(b"\x7fchekc\x7f\bck\nARM\n")
    assert keyboard.read() == ["check", "arm"]
    typing(b"st\x1b[Aop\x1b[3~\n\x1bOC\n")  # arrow up, delete, arrow right
    assert keyboard.read() == ["stop"]
    typing(b"quit\x04")
    assert keyboard.read() == ["quit"]
    typing(b"\n\x1b[")
    assert keyboard.read() == ["quit"]
    typing(b" arm\n")  # the space bar is heard in the middle of anything
    assert keyboard.read() == ["estop", "arm"]
    keyboard.close()


def test_the_end_of_the_input():
    reader, writer = os.pipe()
    keyboard = Keyboard(reader, True)
    os.write(writer, b"stop\n")
    os.close(writer)
    assert keyboard.read() == ["stop"]
    assert keyboard.read() == ["closed"]
    keyboard.close()
    os.close(reader)


def test_an_input_that_cannot_be_read_any_more_is_closed():
    ours, theirs = pty.openpty()
    keyboard = Keyboard(theirs, True)
    os.close(ours)  # the terminal hangs up
    assert keyboard.read() == ["closed"] and keyboard.poll() == []
    keyboard.close()
    os.close(theirs)


def test_an_input_that_fails_is_closed(keys, monkeypatch):
    def fail(descriptor, count):
        raise OSError(5, "Input/output error")

    keyboard = Keyboard(keys[0], True)
    with monkeypatch.context() as broken:
        broken.setattr(os, "read", fail)
        assert keyboard.read() == ["closed"]
    keyboard.close()


def test_an_input_that_somebody_else_has_read_is_not_waited_for(keys):
    reader, _ = keys
    keyboard = Keyboard(reader, True)
    assert keyboard.read() == []
    keyboard.close()


def test_a_socket_can_be_the_keyboard():
    ours, theirs = socket.socketpair()
    keyboard = Keyboard(ours.fileno(), True)
    theirs.send(b"arm\n")
    assert keyboard.read() == ["arm"]
    keyboard.close()
    ours.close()
    theirs.close()


def test_a_terminal_that_a_shell_has_changed_gives_every_key_at_once_again():
    ours, theirs = pty.openpty()
    before = termios.tcgetattr(theirs)
    shown = []
    keyboard = Keyboard(theirs, True, shown.append)
    os.write(ours, b"ax\x7frm")
    assert keyboard.read() == [] and "".join(shown) == "ax\b \brm"
    os.write(ours, b"\n")
    assert keyboard.read() == ["arm"] and shown[-1] == "\n"
    termios.tcsetattr(theirs, termios.TCSANOW, before)
    os.write(ours, b" ")
    assert keyboard.poll() == [] and keyboard.read() == ["estop"]
    keyboard.close()
    assert termios.tcgetattr(theirs) == before
    os.close(ours)
    os.close(theirs)


def test_a_terminal_gives_every_key_and_is_given_back():
    ours, theirs = pty.openpty()
    before = termios.tcgetattr(theirs)
    keyboard = Keyboard(theirs, True)
    assert not termios.tcgetattr(theirs)[3] & (termios.ICANON | termios.ECHO)
    os.write(ours, b"g")
    assert select.select([theirs], [], [], 10)[0]
    assert keyboard.read() == ["held"]
    keyboard.close()
    assert termios.tcgetattr(theirs) == before
    keyboard = Keyboard(theirs, True)
    os.close(ours)
    assert keyboard.read() == ["closed"]  # and no exception
    keyboard.close()
    os.close(theirs)


def event(number: int, value: int, kind: int = 1) -> bytes:
    """An event of a joystick: time, value, kind, number."""
    return struct.pack("IhBB", 12345, value, kind, number)


@pytest.fixture
def stick(tmp_path):
    """A pipe that looks like a joystick, and its file."""
    path = tmp_path / "js0"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    writer = os.open(path, os.O_WRONLY)
    yield path, writer
    os.close(reader)
    os.close(writer)


def test_a_button_that_is_held(stick):
    path, writer = stick
    joystick = Joystick(f"{path}:5")
    assert joystick.poll() == []
    os.write(writer, event(5, 1))
    assert joystick.poll() == joystick.poll() == ["held"]
    os.write(writer, event(5, 0))
    assert joystick.poll() == ["released"]
    assert joystick.poll() == []
    joystick.close()
    with pytest.raises(OSError):
        os.fstat(joystick._descriptor)


def test_other_buttons_axes_and_what_is_told_at_the_start(stick):
    path, writer = stick
    joystick = Joystick(f"{path}:5")
    os.write(writer, event(4, 1) + event(5, 1, kind=2) + event(5, 1, kind=0x81) + event(6, 1))
    assert joystick.poll() == []
    os.write(writer, event(5, 1) + event(4, 0) + event(5, 9, kind=2))
    assert joystick.poll() == ["held"]
    joystick.close()


def test_what_is_told_after_an_overflow_releases_and_never_presses(stick):
    path, writer = stick
    joystick = Joystick(f"{path}:5")
    os.write(writer, event(5, 1))
    assert joystick.poll() == ["held"]
    os.write(writer, event(5, 1, kind=0x81))
    assert joystick.poll() == ["held"]
    os.write(writer, event(5, 0, kind=0x81))
    assert joystick.poll() == ["released"]
    os.write(writer, event(5, 1, kind=0x81))
    assert joystick.poll() == []
    joystick.close()


def test_a_joystick_that_floods_does_not_hold_up_the_loop(stick):
    path, writer = stick
    joystick = Joystick(f"{path}:5")
    os.write(writer, event(3, 1) * MOST_AT_ONCE + event(5, 1))
    assert joystick.poll() == []
    assert joystick.poll() == ["held"]
    assert MOST_AT_ONCE == 100
    joystick.close()
    zeros = Joystick("/dev/zero:0")  # never has nothing to say
    assert zeros.poll() == []
    zeros.close()


@pytest.mark.parametrize("torn", [True, False])
def test_a_joystick_that_is_unplugged_is_let_go_for_good(tmp_path, torn):
    path = tmp_path / "js0"
    os.mkfifo(path)
    joystick = Joystick(f"{path}:0")
    writer = os.open(path, os.O_WRONLY)
    os.write(writer, event(0, 1))
    assert joystick.poll() == ["held"]
    if torn:
        os.write(writer, b"\x01\x02")
    os.close(writer)
    assert joystick.poll() == ["released"]
    writer = os.open(path, os.O_WRONLY | os.O_NONBLOCK)
    os.write(writer, event(0, 1))
    assert joystick.poll() == []
    os.close(writer)
    joystick.close()


def test_joysticks_that_are_none(tmp_path):
    (tmp_path / "file").write_bytes(event(5, 1))
    for name in (str(tmp_path), f"{tmp_path}:", "js:five", "js:-1", f"{tmp_path}:5", f"{tmp_path}/file:5"):
        with pytest.raises(UserError, match=r"--dead_man .*: say which button .* as .*:5$"):
            Joystick(name)
    with pytest.raises(UserError, match=r"js9: no joystick can be read here \(No such file or directory\); plug it in"):
        Joystick(f"{tmp_path}/js9:0")


@pytest.fixture
def remote():
    """Sends datagrams."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        yield lambda datagrams, data: sender.sendto(data, datagrams.address)


def heard(datagrams: Datagrams) -> list[str]:
    """What arrives within some seconds."""
    assert select.select([datagrams], [], [], 10)[0]
    return datagrams.read()


def test_datagrams(remote):
    datagrams = Datagrams("127.0.0.1:0", True)
    assert datagrams.read() == []
    for data in (b"held", b"arm", b"", b"\xff", b"held\n", b"estop", b"x" * 1000, b"released"):
        remote(datagrams, data)
    assert heard(datagrams) == ["held", "estop", "released"]
    assert datagrams.read() == []
    datagrams.close()
    assert datagrams.fileno() == -1


def test_datagrams_that_are_not_the_dead_man_may_only_stop(remote):
    datagrams = Datagrams("127.0.0.1:0", False)
    for data in (b"held", b"released", b"estop"):
        remote(datagrams, data)
    assert heard(datagrams) == ["estop"]
    datagrams.close()


def test_datagrams_that_flood_do_not_hold_up_the_loop(remote):
    datagrams = Datagrams("127.0.0.1:0", True)
    for _ in range(MOST_AT_ONCE + 7):
        remote(datagrams, b"held")
    assert heard(datagrams) == ["held"] * MOST_AT_ONCE
    assert datagrams.read() == ["held"] * 7
    datagrams.close()


def test_a_datagram_that_is_damaged_is_none(remote):
    datagrams = Datagrams("127.0.0.1:0", True)

    class Damaged:
        """The system says that there is something to read, sees that its checksum is wrong, and gives nothing."""

        def recv(self, size):
            raise BlockingIOError

    whole, datagrams._socket = datagrams._socket, Damaged()
    assert datagrams.read() == []
    datagrams._socket = whole
    datagrams.close()


@pytest.mark.parametrize("address", ["", "127.0.0.1", ":5000"])
def test_an_address_says_its_host(address):
    with pytest.raises(UserError, match=rf"--operator {address}: says no host, so anybody could be the operator"):
        Datagrams(address, True)


@pytest.mark.parametrize("address", ["127.0.0.1:", "127.0.0.1:x", "127.0.0.1:70000", "192.0.2.1:9000"])
def test_addresses_at_which_nothing_can_be_heard(address):
    with pytest.raises(UserError, match=rf"--operator {address}: cannot listen there \(.*\); give HOST:PORT"):
        Datagrams(address, True)


def test_an_address_that_is_taken():
    datagrams = Datagrams("127.0.0.1:0", True)
    with pytest.raises(UserError, match="cannot listen there"):
        Datagrams(f"127.0.0.1:{datagrams.address[1]}", True)
    datagrams.close()


def test_a_file_stops_as_long_as_it_is_there(tmp_path):
    file = StopFile(str(tmp_path / "estop"))
    assert file.poll() == []
    (tmp_path / "estop").symlink_to(tmp_path / "nowhere")
    assert file.poll() == file.poll() == ["estop"]
    (tmp_path / "estop").unlink()
    assert file.poll() == []
    file.close()


def test_a_file_that_was_there_before_stops_too(tmp_path):
    (tmp_path / "estop").touch()
    assert StopFile(str(tmp_path / "estop")).poll() == ["estop"]


@pytest.mark.parametrize("name", ["x" * 256, "no_folder/estop"])
def test_a_file_that_can_never_be_made_is_refused(tmp_path, name):
    with pytest.raises(UserError, match="no file can be made there"):
        StopFile(str(tmp_path / name))


def test_keys_that_flood_are_taken_in_pieces(keys):
    reader, typing = keys
    typing(b"g" * 5000)
    keyboard = Keyboard(reader, True)
    assert [len(keyboard.read()), len(keyboard.read())] == [256, 256]
    keyboard.close()
