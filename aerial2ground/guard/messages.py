"""What the policy's process tells the guard, and the guard tells it.

One socket of whole messages (SOCK_SEQPACKET) joins them. The policy's process says READY once it can drive, then one
COMMAND per look at the camera. The guard answers every command with the name of its state.
"""

import binascii
import struct
from dataclasses import astuple, dataclass

READY = b"ready"
_FIELDS = struct.Struct("<IIdddd")
SIZE = _FIELDS.size + 4


@dataclass(frozen=True)
class Command:
    """What the policy wants."""

    number: int
    """Counts commands, from 1."""
    picture: int
    """CRC-32 of the camera's picture: two pictures that are the same to the bit are one."""
    taken: float
    """When the picture was taken, monotonic seconds."""
    sent: float
    """When the command was sent, monotonic seconds."""
    steering: float
    """Radians, positive to the left."""
    speed: float
    """m/s, forwards."""

    def packed(self) -> bytes:
        """The command as bytes; raises struct.error for what is no number."""
        body = _FIELDS.pack(*astuple(self))
        return body + struct.pack("<I", binascii.crc32(body))


def unpack(message: bytes) -> Command | None:
    """Returns the command in a message; None where its size or its checksum is wrong."""
    if len(message) != SIZE:
        return None
    body = message[: _FIELDS.size]
    if struct.unpack_from("<I", message, _FIELDS.size)[0] != binascii.crc32(body):
        return None
    return Command(*_FIELDS.unpack(body))
