"""The loop when its port goes away, comes back, or takes no more bytes."""

import itertools

import pytest

from aerial2ground.guard import loop
from aerial2ground.guard.faults import Fault
from aerial2ground.guard.loop import FIRST_RETRY, LAST_RETRY
from aerial2ground.guard.serial_link import LinkBlocked, LinkLost
from aerial2ground.guard.states import State
from tests.aerial2ground.guard.bench import BRAKE, RPM
from tests.aerial2ground.guard.world import START

LOST, BLOCKED = LinkLost("for a test"), LinkBlocked("for a test")


def test_the_link_of_the_world_is_the_only_port(world):
    world.at(0.5, "quit\n")
    assert world.run() == 0
    assert world.loop.link is world.links[0] and not world.links[0].closed
    world.loop.close_link()
    assert world.loop.link is None and world.links[0].closed
    world.loop.close_link()


def lose(world, how: str, seconds: float = 6.0) -> None:
    """Plans that the port goes away; its next write or read finds that out."""

    def away():
        link = world.links[-1]
        link.fails[how] = LOST
        world.no_port = True
        if how == "read":
            link.theirs.send(b"x")

    world.arms().at(seconds, away)


@pytest.mark.parametrize("how", ["read", "write"])
def test_r17_the_port_is_gone(world, how, bridge_row):
    lose(world, how)
    world.at(30.0, "quit\n")
    found = []
    lose_link = world.loop._lose_link
    world.loop._lose_link = lambda now: (found.append(now - START), lose_link(now))
    assert world.run() == 0
    assert world.guard.fault.name == "LINK_LOST" and world.guard.state is State.FAULT
    assert world.links[0].closed and len(world.links) == 1 and world.loop.link is None
    assert any(line.startswith("LINK_LOST: the serial port is gone") for line in world.said)
    assert not [frame for frame in world.wire if frame[0] > 6.02]
    bridge_row("R17", f"seconds until the fault, found by {how}", found[0] - 6.0, 0.1, "s")


def test_r18_it_is_tried_again_ever_more_rarely(world, bridge_row):
    lose(world, "write")
    world.at(40.0, "quit\n")
    world.run()
    waits = [later - earlier for earlier, later in itertools.pairwise([6.0, *world.attempts[1:]])]
    assert (FIRST_RETRY, LAST_RETRY) == (0.5, 5.0)
    expected = [0.5, 1.0, 2.0, 4.0, 5.0, 5.0]
    assert waits[:6] == [pytest.approx(seconds, abs=0.041) for seconds in expected]
    bridge_row("R18", "longest wait between two attempts", max(waits), 5.05, "s")


def test_r18_a_port_that_comes_back_is_taken_and_not_armed(world, bridge_row):
    lose(world, "read")
    world.at(7.0, lambda: setattr(world, "no_port", False))
    world.at(8.0, "arm\n")
    world.at(14.0, "quit\n")
    world.run()
    assert len(world.links) == 2 and not world.links[1].closed
    assert world.attempts[1:] == [pytest.approx(6.5, abs=0.03), pytest.approx(7.5, abs=0.05)]
    assert world.guard.firmware == (6, 2, "bench") and world.guard.state is State.FAULT
    again = [time for time, _, frames in world.wire if time > 7]
    assert len(again) > 250
    assert any(line.startswith("not armed; it lacks ") for line in world.said)
    bridge_row("R18", "motion after the port has come back", len(world.frames(RPM, 6.03)), 0)


def test_after_a_success_the_waits_begin_anew(world):
    lose(world, "write")
    world.at(9.0, lambda: setattr(world, "no_port", False))  # after attempts at 6.5 and 7.5 it is found at 9.5

    def lose_again():
        world.links[-1].fails["write"] = LOST
        world.no_port = True

    world.at(12.0, lose_again)
    world.at(14.5, "quit\n")
    world.run()
    assert world.attempts[1:] == [pytest.approx(time, abs=0.1) for time in (6.5, 7.5, 9.5, 12.5, 13.5)]
    assert len(world.links) == 2


def test_bytes_of_the_old_port_are_no_part_of_the_new_one(world):
    world.at(2.0, lambda: world.answer(world.links[0], b"\x02\xff"))
    lose(world, "write", 2.02)
    world.at(2.1, lambda: setattr(world, "no_port", False))
    world.at(4.0, "quit\n")
    world.run()
    assert world.loop._parser.dropped == 0 and world.loop._parser.frames > 30


@pytest.mark.parametrize("lasts", [0.1, 5.0])
def test_x3_a_port_that_takes_no_more_bytes(world, lasts, bridge_row):
    moments = []

    class Stuck(LinkBlocked):
        """Tells when it is raised."""

        def __init__(self):
            moments.append(world.now - START)

    def block():
        world.links[0].fails["write"] = Stuck

    def goes_on():
        world.links[0].fails.clear()

    world.arms().at(6.0, block)
    world.at(6.0 + lasts, goes_on)
    world.at(12.0, "quit\n")
    assert world.run() == 0
    assert world.guard.fault.name == "LINK_BLOCKED"
    assert any(line.startswith("LINK_BLOCKED") for line in world.said)
    assert not world.frames(RPM, 6.001)
    assert world.links[0].dropped == len(moments)  # what is old is forgotten each time
    if lasts < 1:
        assert len(world.frames(BRAKE, 6.1)) > 10
    gaps = [later - earlier for earlier, later in itertools.pairwise(moments)]
    bridge_row("X3", f"blocked for {lasts} s: seconds until the fault", moments[0] - 6.0, 0.25, "s")
    bridge_row("X3", f"blocked for {lasts} s: longest gap between two cycles", max(gaps), 0.06, "s")


def test_a_port_that_is_gone_while_old_bytes_are_dropped(world):
    world.arms().at(6.0, lambda: world.links[0].fails.update(write=BLOCKED, drop=LOST))
    world.at(6.0, lambda: setattr(world, "no_port", True))
    world.at(8.0, "quit\n")
    assert world.run() == 0
    assert world.guard.fault.name == "LINK_BLOCKED" and world.guard.state is State.STOPPING
    assert world.links[0].closed and len(world.attempts) > 1


def test_a_port_that_is_gone_while_it_ends(world):
    lose(world, "write")
    world.at(5.99, "quit\n")
    assert world.run() == 0
    assert world.now - START < 7.0


def test_the_operator_is_told_once_a_second_while_the_car_drives(world):
    world.arms().at(7.4, "quit\n")
    world.run()
    lines = [line for line in world.said if line.startswith("steering")]
    # armed from 4.1 to 7.4 s
    assert 3 <= len(lines) <= 4
    assert lines[-1].startswith("steering +0.000 rad, picture ") and lines[-1].endswith(" ms old, 1.00 m/s, 11.8 V")


def test_a_sentence_is_said_once_a_second(world):
    world.at(1.0, "nonsense\n" * 20)
    world.at(1.5, "nonsense\n")
    world.at(2.5, "nonsense\n")
    world.at(3.0, "quit\n")
    world.run()
    assert sum("'nonsense' is no command" in line for line in world.said) == 2


def test_sentences_without_end_are_forgotten(world, monkeypatch):
    monkeypatch.setattr(loop, "MOST_SENTENCES", 5)
    for number in range(10):
        world.at(1.0 + 0.1 * number, f"word{number}\n")
    world.at(3.0, "quit\n")
    world.run()
    assert len(world.loop._said) <= 6 and sum("is no command" in line for line in world.said) == 10


def test_of_a_flood_of_words_only_stops_are_heard(world):
    world.arms().at(6.0, "y\n" * 100)
    for part in range(1, 40):
        world.at(6.0 + 0.0001 * part, "y\n" * 100)
    world.at(6.01, " ")
    world.at(7.5, "quit\n")
    world.run()
    assert world.guard.fault is Fault.E_STOP
    assert max(len(record["in"]) for record in world.records()[1:]) <= loop.MOST_HAPPENINGS + 2


def test_a_hand_of_before_a_sleep_is_not_one_of_now(world):
    def sleep():
        world.type("g")  # pressed, let go, and read only 90 ms later
        world.hand = False
        world.now += 0.09

    world.arms().at(6.0, sleep)
    world.at(7.5, "quit\n")
    world.run()
    (first, *_) = world.frames(BRAKE, 6.0)
    # 80 ms after the period in which the key could have been read, not after that in which it was
    assert first[0] <= 6.0 + 0.02 + 0.08 + 0.04


def test_a_speed_that_is_not_known_is_not_in_the_black_box(world):
    world.arms().at(6.0, lambda: setattr(world.car, "answers", False))
    world.at(9.5, "quit\n")
    world.run()
    known = {record["erpm"] is not None for record in world.records()[1:] if 6.0 < record["t"] - START < 6.2}
    unknown = {record["erpm"] is None for record in world.records()[1:] if 6.5 < record["t"] - START < 8.0}
    assert known == unknown == {True}
    assert any("THE CAR MAY STILL ROLL" in line for line in world.said)
