"""Bytes of the serial protocol, against frames written down by hand and answers put together byte by byte."""

import math
import random
import resource
import struct
from pathlib import Path

import pytest

from aerial2ground.guard.vesc import (
    ALIVE,
    FW_VERSION,
    GET_VALUES,
    STALLED,
    FrameParser,
    Values,
    frame,
    query,
    read_firmware,
    read_values,
    set_brake,
    set_current,
    set_rpm,
    set_servo,
)
from tests.aerial2ground.guard.bench import answer, crc16, staged, taken_apart

RPM_FRAME = bytes.fromhex("0205080000120607fa03")


def memory() -> int:
    """Bytes of memory that this process has."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def whole(payload: bytes) -> bytes:
    """A frame, put together by other means than the guard's."""
    head = bytes([2, len(payload)]) if len(payload) < 256 else b"\x03" + len(payload).to_bytes(2, "big")
    return head + payload + crc16(payload).to_bytes(2, "big") + b"\x03"


@pytest.mark.parametrize(
    ("made", "known"),
    [
        (lambda: set_rpm(4614.0), "02 05 08 00 00 12 06 07 fa 03"),
        (lambda: set_rpm(3000.0), "02 05 08 00 00 0b b8 f8 04 03"),
        (lambda: set_brake(10.0), "02 05 07 00 00 27 10 ea 94 03"),
        (lambda: set_current(0.0), "02 05 06 00 00 00 00 cd 85 03"),
        (lambda: set_current(1.5), "02 05 06 00 00 05 dc 38 81 03"),
        (lambda: set_servo(0.53), "02 03 0c 02 12 21 70 03"),
        (lambda: query(GET_VALUES), "02 01 04 40 84 03"),
        (lambda: query(FW_VERSION), "02 01 00 00 00 03"),
        (lambda: frame(bytes([ALIVE])), "02 01 1e f3 ff 03"),
    ],
)
def test_golden_frames(made, known):
    assert made() == bytes.fromhex(known)


def test_the_checksum_of_the_bench_is_the_standard_one():
    assert crc16(b"123456789") == 0x31C3


def test_negative_set_points_are_twos_complement():
    assert taken_apart(set_rpm(-1.0)) == ((8, -1),)
    assert taken_apart(set_servo(-0.002)) == ((12, -2),)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e9 + 2**31, -(2.0**31), 1e308])
def test_r07_no_set_point_is_made_of_what_is_no_number(value, bridge_row):
    made = 0
    for encode in (set_rpm, set_current, set_brake, set_servo):
        with pytest.raises(ValueError, match=r"^\S+ is no set-point$"):
            made += len(encode(value))
    bridge_row("R07", f"frames made of {value}", made, 0)


@pytest.mark.parametrize(
    ("encode", "most"),
    [(set_rpm, 2.0**31 - 1), (set_current, 2147483.647), (set_brake, 2147483.647), (set_servo, 32.767)],
)
def test_the_largest_set_points_of_the_wire(encode, most):
    wire = (2**15 if encode is set_servo else 2**31) - 1
    assert taken_apart(encode(most))[0][1] == wire
    assert taken_apart(encode(-most))[0][1] == -wire
    with pytest.raises(ValueError, match="no set-point"):
        encode(most + 1)


def test_set_points_are_rounded_to_the_wire():
    assert taken_apart(set_servo(0.5306))[0][1] == 531
    assert taken_apart(set_servo(0.5304))[0][1] == 530
    assert taken_apart(set_rpm(2.6))[0][1] == 3
    assert taken_apart(set_brake(0.0006))[0][1] == 1


@pytest.mark.parametrize("size", [1, 255, 256, 512])
def test_payloads_of_every_size_come_back(size):
    payload = bytes(random.Random(size).randbytes(size))
    assert frame(payload) == whole(payload)
    parser = FrameParser()
    assert parser.feed(frame(payload), 0.0) == [payload]
    assert (parser.frames, parser.dropped) == (1, 0)


@pytest.mark.parametrize("size", [0, 513])
def test_payloads_that_no_frame_holds(size):
    with pytest.raises(ValueError, match=f"1 to 512 bytes, not {size}"):
        frame(bytes(size))


def test_values_are_read_from_their_places():
    payload = answer(-1234, 11.8, 5, 41.5, 3)
    assert read_values(payload) == Values(-1234, 11.8, 5, 41.5, 3)
    assert read_values(payload[:73]) == Values(-1234, 11.8, 5, 41.5, None)
    assert read_values(payload[:54]) == Values(-1234, 11.8, 5, 41.5, None)
    assert read_values(payload + b"later firmware says more") == Values(-1234, 11.8, 5, 41.5, 3)


def test_negative_temperatures_and_large_numbers():
    assert read_values(answer(2**31 - 1, 60, 255, -20)) == Values(2**31 - 1, 60.0, 255, -20.0, 0)


def test_what_is_no_answer_gives_no_values():
    assert read_values(b"") is None
    assert read_values(answer()[:53]) is None
    assert read_values(b"\x32" + answer()[1:]) is None
    assert read_values(b"\x04") is None


def test_firmware():
    assert read_firmware(b"\x00\x06\x02VESC 6\x00and a number") == (6, 2, "VESC 6")
    assert read_firmware(b"\x00\x06\x02") == (6, 2, "")
    assert read_firmware(b"\x00\x05\x03\xff\x00") == (5, 3, "�")
    assert read_firmware(b"\x00\x06") is None
    assert read_firmware(b"\x00") is None
    assert read_firmware(b"") is None
    assert read_firmware(b"\x04\x06\x02") is None


def test_the_parser_takes_byte_by_byte():
    parser = FrameParser()
    found = [payload for byte in RPM_FRAME for payload in parser.feed(bytes([byte]), 0.0)]
    assert found == [RPM_FRAME[2:7]]
    assert (parser.frames, parser.dropped) == (1, 0)


@pytest.mark.parametrize("place", [0, 1, 7, 8, 9])
def test_one_wrong_byte_costs_one_frame_and_every_byte_of_it(place):
    torn = bytearray(RPM_FRAME)
    torn[place] ^= 0x80
    parser = FrameParser()
    found = parser.feed(bytes(torn) + RPM_FRAME * 30, 0.0)  # enough for the longest frame that `torn` can announce
    assert found == [RPM_FRAME[2:7]] * 30
    assert (parser.frames, parser.dropped) == (30, 10)


def test_r20_a_torn_frame_is_no_other_command_and_the_next_one_is_found(bridge_row):
    wrong = 0
    for cut in range(1, len(RPM_FRAME)):
        parser = FrameParser()
        found = parser.feed(RPM_FRAME[:cut] + whole(b"\x04") + whole(answer()) * 4, 0.0)
        wrong += found[-3:] != [answer()] * 3 or not set(found) <= {b"\x04", answer()}
    bridge_row("R20", "frames cut off at every byte: wrong commands, or sound ones lost for good", wrong, 0)


@pytest.mark.parametrize(
    ("noise", "dropped"),
    [
        (b"\x02\x00", 2),  # no payload is empty
        (b"\x03\x00\xfe", 3),  # a long frame holds 255 bytes at least
        (b"\x03\x02\x01", 3),  # and 512 at most
        (b"\x04\x01\xff\x00", 4),
        (b"\x01\x02", 1),  # the 2 starts a frame of 2 bytes that never is one
    ],
)
def test_noise_before_a_frame(noise, dropped):
    parser = FrameParser()
    found = parser.feed(noise + RPM_FRAME * 2, 0.0)
    assert found[-1:] == [RPM_FRAME[2:7]]
    assert parser.frames == len(found)
    assert parser.dropped >= dropped
    assert parser.dropped + 10 * parser.frames == len(noise) + 20


def test_a_long_frame_of_255_bytes_is_one():
    payload = bytes(255)
    parser = FrameParser()
    long = b"\x03\x00\xff" + payload + crc16(payload).to_bytes(2, "big") + b"\x03"
    assert parser.feed(long, 0.0) == [payload]


def test_the_head_of_a_frame_that_never_comes_is_dropped_after_a_while():
    stalled = b"\x02\xff"
    parser = FrameParser()
    parser.feed(stalled, 0.0)
    assert parser.feed(RPM_FRAME, STALLED) == []  # it may still come
    assert parser.feed(b"", 2 * STALLED) == []
    assert parser.dropped == 0
    assert parser.feed(b"", 2 * STALLED + 0.001) == [RPM_FRAME[2:7]]
    assert (parser.frames, parser.dropped) == (1, 2)


def test_silence_between_frames_costs_nothing():
    parser = FrameParser()
    assert parser.feed(RPM_FRAME, 0.0) == parser.feed(RPM_FRAME, 10.0) == [RPM_FRAME[2:7]]
    assert parser.dropped == 0


def test_only_bytes_that_arrive_keep_a_frame_waiting():
    parser = FrameParser()
    parser.feed(b"\x02\x09", 0.0)
    parser.feed(b"", 0.09)
    parser.feed(b"", 0.11)
    assert parser.dropped == 2


def test_r20_a_million_random_and_mutated_bytes(bridge_row):
    chance = random.Random(0)
    guard = staged("driving").guard
    parser, fed, sound, found = FrameParser(), 0, 0, 0
    begun = memory()
    now = guard._ticked
    while fed < 1_000_000:
        mutated = bytearray(whole(answer(chance.randrange(5000))) * 20)
        for _ in range(chance.randrange(6)):
            mutated[chance.randrange(len(mutated))] = chance.randrange(256)
        kind = chance.randrange(3)
        data = bytes(mutated) if kind == 0 else chance.randbytes(2000) if kind == 1 else whole(b"\x08\0\0\x12\6") * 99
        sound += 99 if kind == 2 else 0
        for payload in parser.feed(data, now):
            found += payload == b"\x08\0\0\x12\6"
            guard.take("payload", payload.hex(), now)
        guard.tick(now)
        guard.notes.clear()
        fed, now = fed + len(data), now + 0.02
    grown = memory() - begun
    parser.feed(b"", now + 1)
    held = len(parser._buffer)
    assert held < 520
    # every sound frame is found, but for those behind a head of noise that are eaten up with it: fewer than one in 50
    assert 0.98 * sound <= found <= sound
    bridge_row("R20", "growth of the memory while a million bytes of noise arrive", grown / 1e6, 5, "MB")


def test_counters_hold_every_byte():
    chance = random.Random(1)
    parser, fed, framed = FrameParser(), 0, 0
    for index in range(300):
        data = chance.randbytes(50) + whole(chance.randbytes(chance.randrange(1, 300)))
        framed += sum(len(whole(payload)) for payload in parser.feed(data, index * 0.01))
        fed += len(data)
    assert parser.frames > 200
    assert parser.dropped + framed + len(parser._buffer) == fed


def test_values_are_frozen():
    with pytest.raises(AttributeError):
        read_values(answer()).erpm = 1
    assert struct.calcsize(">BhhiiiihihiiiiiiBiBhhhiiB") == len(answer())


def test_a_frame_without_payload_is_none():
    parser = FrameParser()
    assert parser.feed(bytes.fromhex("0200000003"), 0.0) == [] and parser.frames == 0
