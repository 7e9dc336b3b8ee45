"""The fake controller: its bytes are a VESC's, and its motor does what can be worked out by hand."""

import math
import os
import select
import threading
import time

import pytest

from aerial2ground.bridge.fake_vesc import FakeVesc, Motor
from aerial2ground.bridge.wire import Received
from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.vesc import (
    FW_VERSION,
    GET_VALUES,
    SET_BRAKE,
    SET_CURRENT,
    SET_RPM,
    SET_SERVO,
    FrameParser,
    frame,
    query,
    read_firmware,
    read_values,
    set_brake,
    set_rpm,
    set_servo,
)
from hashnerf.errors import UserError

CAR = Actuation()
GOLDEN = {
    "02 05 08 00 00 12 06 07 fa 03": (SET_RPM, 4614),
    "02 05 07 00 00 27 10 ea 94 03": (SET_BRAKE, 10),
    "02 05 06 00 00 00 00 cd 85 03": (SET_CURRENT, 0),
    "02 03 0c 02 12 21 70 03": (SET_SERVO, 0.53),
}


class Wire:
    """The other end: raw bytes, no library."""

    def __init__(self, port):
        self.descriptor = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self.parser = FrameParser()

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        os.close(self.descriptor)

    def send(self, data):
        assert os.write(self.descriptor, data) == len(data)

    def raw(self, count, seconds=5.0):
        data, end = b"", time.monotonic() + seconds
        while len(data) < count and time.monotonic() < end:
            if select.select([self.descriptor], [], [], 0.05)[0]:
                data += os.read(self.descriptor, 4096)
        return data

    def answers(self, count, seconds=5.0):
        found, end = [], time.monotonic() + seconds
        while len(found) < count and time.monotonic() < end:
            found += self.parser.feed(self.raw(1, 0.05), time.monotonic())
        return found


def eventually(condition, seconds=5.0):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.002)
    return condition()


def heard(fake):
    return [one.payload for one in fake.received]


# the motor, in a time of its own


def test_golden_frames_are_understood_as_they_are():
    with FakeVesc() as fake, Wire(fake.port) as wire:
        for text in GOLDEN:
            wire.send(bytes.fromhex(text))
        assert eventually(lambda: len(fake.received) == 4)
        assert [(one.kind, one.value) for one in fake.received] == list(GOLDEN.values())
        assert fake.dropped == 0
        times = [one.time for one in fake.take()]
        assert times == sorted(times) and time.monotonic() - times[0] < 60
        assert fake.received == []


def test_every_byte_passes_both_ways():
    payload = bytes([99, *range(256)])
    with FakeVesc() as fake, Wire(fake.port) as wire:
        wire.send(frame(payload))
        assert eventually(lambda: heard(fake) == [payload])
        fake.garbage(bytes(range(256)))
        assert wire.raw(256) == bytes(range(256))


def test_firmware_and_values_to_the_byte():
    with FakeVesc(timeout=None) as fake, Wire(fake.port) as wire:
        wire.send(bytes.fromhex("020100000003"))
        answer = wire.raw(29)
        # length 24: id, 6, 2, "FAKE" and 0, 12 bytes of serial number, 4 zeros
        assert answer[:2] == b"\x02\x18" and answer[2:10] == b"\0\x06\x02FAKE\0" and answer[22:26] == bytes(4)
        assert read_firmware(answer[2:26]) == (6, 2, "FAKE") and answer[-1] == 3 and len(answer) == 29
        fake.voltage, fake.fault, fake.temperature, fake.motor.kill_switch = 9.4, 3, 81.5, True
        wire.send(bytes.fromhex("020104408403"))
        answer = wire.raw(79)
        payload = answer[2:-3]
        assert len(payload) == 74 and answer[1] == 74
        # offsets of the firmware: temperature 1, erpm 23, voltage 27, fault 53, status 73
        assert payload[1:3] == (815).to_bytes(2, "big") and payload[27:29] == (94).to_bytes(2, "big")
        assert payload[23:27] == bytes(4) and payload[53] == 3 and payload[73] == 2


def test_values_tell_speed_and_timeout():
    with FakeVesc(timeout=0.3) as fake, Wire(fake.port) as wire:

        def values():
            wire.send(query(GET_VALUES))
            return read_values(wire.answers(1)[0])

        assert eventually(lambda: values().status == 1), "nobody has commanded anything"

        def driving():
            wire.send(set_rpm(-4614.0))
            told = values()
            return told.status == 0 and told.erpm == -4614

        assert eventually(driving)
        assert fake.state.speed == pytest.approx(-1.0) and fake.state.distance < 0 and not fake.state.timed_out
        assert eventually(lambda: fake.state.timed_out and fake.state.speed == 0.0)
        assert values().status == 1


def test_old_firmware_tells_no_status():
    with FakeVesc(with_status=False) as fake, Wire(fake.port) as wire:
        wire.send(query(GET_VALUES))
        payload = wire.answers(1)[0]
        assert len(payload) == 73 and read_values(payload).status is None


def test_torn_frames_and_garbage():
    good, bad = set_rpm(1000.0), bytearray(set_rpm(2000.0))
    bad[5] ^= 1
    with FakeVesc() as fake, Wire(fake.port) as wire:
        wire.send(good[:4])
        time.sleep(0.02)
        wire.send(good[4:])
        wire.send(b"\x07\xff" + bytes(bad) + set_servo(0.5) + b"\x02\xf0" + set_brake(3.0))
        # a false head that asks for 240 bytes holds up the brake until it is found out
        assert eventually(lambda: len(fake.received) == 3)
        assert [(one.kind, one.value) for one in fake.received] == [(SET_RPM, 1000), (SET_SERVO, 0.5), (SET_BRAKE, 3)]
        assert fake.dropped == 2 + len(bad) + 2


def test_what_is_no_vesc_says_nothing_or_what_it_hears():
    with FakeVesc(firmware=None) as fake, Wire(fake.port) as wire:
        wire.send(query(FW_VERSION) + query(GET_VALUES))
        assert eventually(lambda: len(fake.received) == 2) and wire.raw(1, 0.1) == b""
    with FakeVesc(mode="echo") as fake, Wire(fake.port) as wire:
        wire.send(query(FW_VERSION))
        assert wire.raw(6) == query(FW_VERSION) and wire.raw(1, 0.1) == b""


def test_silence_can_begin_and_end():
    with FakeVesc() as fake, Wire(fake.port) as wire:
        fake.mode = "silent"
        wire.send(query(GET_VALUES))
        assert eventually(lambda: len(fake.received) == 1) and wire.raw(1, 0.1) == b""
        fake.answer()
        wire.send(query(GET_VALUES))
        assert len(wire.answers(1)) == 1


def test_answers_come_late_and_in_order():
    with FakeVesc(delay=0.3) as fake, Wire(fake.port) as wire:
        start = time.monotonic()
        wire.send(query(FW_VERSION) + query(GET_VALUES))
        assert [answer[0] for answer in wire.answers(2)] == [FW_VERSION, GET_VALUES]
        assert time.monotonic() - start >= 0.3


def ask(fake, wire, times=60):
    for _ in range(times):
        wire.send(query(GET_VALUES))
    answers = wire.answers(times, 0.7)
    assert len(fake.received) == times
    return len(answers), wire.parser.dropped


def test_answers_are_lost_and_spoilt():
    with FakeVesc(drop=0.5) as fake, Wire(fake.port) as wire:
        whole, noise = ask(fake, wire)
        assert 15 < whole < 45 and noise == 0
    with FakeVesc(corrupt=0.5) as fake, Wire(fake.port) as wire:
        whole, noise = ask(fake, wire)
        assert whole < 45 and noise >= 79
    with FakeVesc(corrupt=1.0) as fake, Wire(fake.port) as wire:
        assert ask(fake, wire, 5)[0] == 0


def test_a_stall_fills_the_writers_buffer_and_loses_nothing():
    with FakeVesc() as fake, Wire(fake.port) as wire:
        fake.stall_reads()
        time.sleep(0.05)  # it may be reading just now
        written = 0
        with pytest.raises(BlockingIOError):
            while True:
                written += os.write(wire.descriptor, set_rpm(1000.0))
        assert 1000 < written < 100_000 and not fake.received
        fake.answer()
        assert eventually(lambda: len(fake.received) == written // 10)


def test_answers_that_nobody_reads_are_lost_without_harm():
    with FakeVesc(delay=0.0) as fake, Wire(fake.port) as wire:
        fake.garbage(bytes(200_000))
        assert fake.unsent > 100_000
        wire.send(set_rpm(1.0))
        assert eventually(lambda: len(fake.received) == 1)


def test_unplugging_ends_the_line_and_not_the_motor(tmp_path):
    link = tmp_path / "car"
    with FakeVesc(timeout=0.1, timeout_brake_current=0.0, link=link) as fake:
        with Wire(str(link)) as wire:
            wire.send(set_rpm(4614.0))
            assert eventually(lambda: fake.state.speed > 0.1)
            fake.disconnect()
            assert not fake.plugged and not os.path.lexists(link)
            with pytest.raises(OSError):
                os.write(wire.descriptor, b"x")
            before = fake.state.distance
            assert eventually(lambda: fake.state.distance > before and fake.state.timed_out), "it rolls on"
            fake.disconnect()
            fake.reconnect()
        assert fake.plugged and os.path.realpath(link) == os.path.realpath(fake.port)
        with Wire(str(link)) as wire:
            wire.send(query(FW_VERSION))
            assert read_firmware(wire.answers(1)[0]) == (6, 2, "FAKE")
        fake.reconnect()
        assert fake.plugged
    assert not os.path.lexists(link)


def test_answers_do_not_wait_for_the_next_plug():
    with FakeVesc(delay=0.1) as fake:
        with Wire(fake.port) as wire:
            wire.send(query(GET_VALUES))
            assert eventually(lambda: len(fake.received) == 1)
        fake.disconnect()
        fake.reconnect()
        with Wire(fake.port) as wire:
            assert wire.raw(1, 0.3) == b""


def test_a_link_never_replaces_a_file(tmp_path):
    path = tmp_path / "notes"
    path.write_text("mine")
    with pytest.raises(UserError, match="notes"):
        FakeVesc(link=path)
    assert path.read_text() == "mine"


def test_nothing_is_left_behind():
    def own():
        return len(os.listdir("/proc/self/fd")), threading.active_count()

    before = own()
    for _ in range(3):
        with FakeVesc() as fake:
            fake.disconnect()
            fake.reconnect()
    assert own() == before
    with pytest.raises(RuntimeError, match="closed"):
        fake.garbage(b"x")


def test_the_car_moves_with_motor_and_servo():
    ways = []
    motor = Motor(CAR, None, 10.0, 0.0)
    motor.on_motion = lambda way, steering, now: ways.append((way, steering, now))
    motor.obey(Received(0.0, FrameParser().feed(set_rpm(4614.0), 0.0)[0]))
    motor.advance(1.0)
    assert math.fsum(way for way, _, _ in ways) == pytest.approx(motor.distance) == pytest.approx(1 / 6 + 2 / 3)
    assert ways[-1][2] == pytest.approx(1.0) and len(ways) >= 200


def test_a_clogged_controller_takes_no_byte_until_it_reads_again():
    with FakeVesc() as vesc, Wire(vesc.port) as wire:
        vesc.clog()
        with pytest.raises(BlockingIOError):
            wire.send(query(GET_VALUES))
        vesc.answer()
        end = time.monotonic() + 10
        while vesc.dropped < 4000 and time.monotonic() < end:
            time.sleep(0.01)
        wire.send(query(GET_VALUES))
        assert read_values(wire.answers(1)[0])
