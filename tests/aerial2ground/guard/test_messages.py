"""The policy's message: its bytes are agreed on, and what is damaged is none."""

import struct

import pytest

from aerial2ground.guard.messages import READY, SIZE, Command, unpack
from tests.aerial2ground.guard.bench import command

COMMAND = Command(7, 0xFFFFFFFF, 1.25, 1.5, -0.1, 0.75)


def test_the_bytes_are_the_agreed_ones():
    assert COMMAND.packed() == command(7, 0xFFFFFFFF, 1.25, 1.5, -0.1, 0.75)
    assert len(COMMAND.packed()) == SIZE == 44
    assert READY == b"ready"


def test_a_message_comes_back():
    assert unpack(COMMAND.packed()) == COMMAND


def test_every_flipped_bit_is_noticed():
    message = COMMAND.packed()
    for place in range(8 * SIZE):
        wrong = bytearray(message)
        wrong[place // 8] ^= 1 << place % 8
        assert unpack(bytes(wrong)) is None, place


@pytest.mark.parametrize("size", [0, 1, SIZE - 1, SIZE + 1, 2 * SIZE])
def test_wrong_sizes(size):
    assert unpack((COMMAND.packed() * 2)[:size]) is None


def test_numbers_that_the_message_does_not_hold():
    with pytest.raises(struct.error):
        Command(2**32, 0, 0.0, 0.0, 0.0, 0.0).packed()
