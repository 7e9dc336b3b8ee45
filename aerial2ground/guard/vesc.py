"""The serial protocol of the VESC motor controller: frames, set-points out, values in.

A frame is `02 length payload crc_hi crc_lo 03` up to 255 bytes of payload and `03 length_hi length_lo ...` up to 512;
the CRC is CRC-16/XMODEM of the payload; numbers are big-endian. Source: comm/packet.c and datatypes.h of firmware 7.01.
"""

import binascii
import math
import struct
from dataclasses import dataclass

FW_VERSION, GET_VALUES, SET_CURRENT, SET_BRAKE, SET_RPM, SET_SERVO, ALIVE = 0, 4, 6, 7, 8, 12, 30
LONGEST = 512
"""Bytes of payload."""
STALLED = 0.1
"""Seconds without a byte after which the head of an unfinished frame is taken for noise."""
VALUES = ">BhhiiiihihiiiiiiBiBhhhiiB"
VALUES_WITHOUT_STATUS = struct.calcsize(VALUES) - 1


@dataclass(frozen=True)
class Values:
    """What the controller says about itself (COMM_GET_VALUES)."""

    erpm: int
    """Electrical revolutions per minute."""
    voltage: float
    """Of the battery, volts."""
    fault: int
    """Fault code; 0: none."""
    temperature: float
    """Of the power stage, degrees Celsius."""
    status: int | None
    """Bit 0: the controller's own timeout has struck; bit 1: kill switch. None where the firmware is too old to say."""


def frame(payload: bytes) -> bytes:
    """Returns a payload as it goes over the wire; raises ValueError for an empty or too long one."""
    if not 1 <= len(payload) <= LONGEST:
        raise ValueError(f"a payload has 1 to {LONGEST} bytes, not {len(payload)}")
    head = struct.pack(">BB", 2, len(payload)) if len(payload) < 256 else struct.pack(">BH", 3, len(payload))
    return head + payload + struct.pack(">HB", binascii.crc_hqx(payload, 0), 3)


def set_rpm(erpm: float) -> bytes:
    """Set-point of the electrical speed, 1/min."""
    return frame(struct.pack(">Bi", SET_RPM, _whole(erpm, 1, 2**31)))


def set_current(amperes: float) -> bytes:
    """Set-point of the motor's current; 0 lets it roll."""
    return frame(struct.pack(">Bi", SET_CURRENT, _whole(amperes, 1000, 2**31)))


def set_brake(amperes: float) -> bytes:
    """Brakes with a current."""
    return frame(struct.pack(">Bi", SET_BRAKE, _whole(amperes, 1000, 2**31)))


def set_servo(position: float) -> bytes:
    """Turns the steering servo to a position between 0 and 1."""
    return frame(struct.pack(">Bh", SET_SERVO, _whole(position, 1000, 2**15)))


def query(command: int) -> bytes:
    """A request without arguments: FW_VERSION or GET_VALUES."""
    return frame(bytes([command]))


def _whole(value: float, scale: int, bound: int) -> int:
    """A set-point as the wire's integer; raises ValueError where it is none: NaN must not become full reverse."""
    if not math.isfinite(value * scale) or abs(round(value * scale)) >= bound:
        raise ValueError(f"{value} is no set-point")
    return round(value * scale)


def read_values(payload: bytes) -> Values | None:
    """Returns the answer to GET_VALUES; None for any other payload, or one that is too short to hold the fault code."""
    if not payload or payload[0] != GET_VALUES or len(payload) < 54:
        return None
    padded = payload.ljust(struct.calcsize(VALUES), b"\0")
    numbers = struct.unpack_from(VALUES, padded)
    status = numbers[-1] if len(payload) > VALUES_WITHOUT_STATUS else None
    return Values(numbers[8], numbers[9] / 10, numbers[16], numbers[1] / 10, status)


def read_firmware(payload: bytes) -> tuple[int, int, str] | None:
    """Returns major and minor version and the hardware's name; None where this is no answer to FW_VERSION."""
    if len(payload) < 3 or payload[0] != FW_VERSION:
        return None
    return payload[1], payload[2], payload[3:].split(b"\0")[0].decode("ascii", errors="replace")


class FrameParser:
    """Finds frames in a stream of bytes; after anything that is none it drops one byte and looks again."""

    def __init__(self) -> None:
        self.frames = self.dropped = 0
        """Whole frames seen, and bytes that belonged to none."""
        self._buffer = bytearray()
        self._last = -math.inf

    def feed(self, data: bytes, now: float) -> list[bytes]:
        """Returns the payloads that became whole when `data` arrived at `now` (s)."""
        if self._buffer and now - self._last > STALLED:
            self._take(1)
        if data:
            self._buffer += data
            self._last = now
        payloads = []
        while (settled := self._settled()) is not None:
            size, payload = settled
            self._take(size, payload is not None)
            if payload is not None:
                payloads.append(payload)
        return payloads

    def _take(self, size: int, is_frame: bool = False) -> None:
        del self._buffer[:size]
        self.frames += is_frame
        self.dropped += 0 if is_frame else size

    def _settled(self) -> tuple[int, bytes | None] | None:
        """How many bytes at the head are settled and the payload they hold, None for noise; None while bytes lack."""
        buffer = self._buffer
        if not buffer:
            return None
        head = buffer[0]  # a start byte says how long the head is, too
        if head not in (2, 3):
            return 1, None
        if len(buffer) < head:
            return None
        length = int.from_bytes(buffer[1:head], "big")
        if not (1 if head == 2 else 255) <= length <= LONGEST:
            return 1, None
        size = head + length + 3
        if len(buffer) < size:
            return None
        payload = bytes(buffer[head : head + length])
        whole = buffer[size - 3 : size] == struct.pack(">HB", binascii.crc_hqx(payload, 0), 3)
        return (size, payload) if whole else (1, None)
