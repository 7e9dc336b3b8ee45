"""The loop in virtual time: whole drives, how they end, and what the black box makes of them."""

import io
import itertools
import math
import os
import threading

import pytest

from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.guard import Guard, GuardSettings
from aerial2ground.guard.loop import END_SECONDS, MOST_HAPPENINGS, MOST_MESSAGES, Announcer
from aerial2ground.guard.operator_input import StopFile
from aerial2ground.guard.states import State
from hashnerf.errors import UserError
from tests.aerial2ground.guard.bench import ANSWER, BRAKE, CURRENT, FIRMWARE, RPM, SERVO
from tests.aerial2ground.guard.world import START


def test_a_whole_drive(world):
    world.arms().at(7.0, "quit\n")
    assert world.run() == 0
    assert world.guard.state is State.DISARMED and world.guard.fault is None
    kinds = [kind for kind, _ in itertools.groupby(frames[0][0] for _, _, frames in world.wire)]
    assert kinds == [FIRMWARE, BRAKE, CURRENT, ANSWER, CURRENT, BRAKE, RPM, BRAKE, CURRENT]
    assert max(value for _, value in world.frames(RPM)) == 4614
    assert len(world.frames(BRAKE, 7.0)) >= 24
    assert world.wire[-1][2] == ((CURRENT, 0), (SERVO, 530), (ANSWER, 0))
    heard = [name for name, _ in itertools.groupby(world.heard)]
    assert heard == ["DISARMED", "READY", "ARMED", "STOPPING"]
    ways = [line.partition(":")[0] for line in world.said if "->" in line]
    assert ways == ["DISARMED -> READY", "READY -> ARMED", "ARMED -> STOPPING", "STOPPING -> DISARMED"]
    assert world.attempts == [0.0]


def test_a_cycle_every_20_ms(world):
    world.arms().at(6.0, "quit\n")
    world.run()
    times = [time for time, _, _ in world.wire]
    gaps = [later - earlier for earlier, later in itertools.pairwise(times) if earlier > 1]
    # all but the emergency cycles in which something changed: arm, and quit
    assert sum(abs(gap - 0.02) > 1e-6 for gap in gaps) <= 4
    assert max(gaps) < 0.0201


def test_time_that_is_lost_is_not_caught_up_with(world):
    def hold_up():
        world.now += 0.5

    world.at(1.0, hold_up)
    world.at(2.0, "quit\n")
    world.run()
    assert len([time for time, _, _ in world.wire if 1.0 <= time < 1.6]) <= 7


@pytest.mark.parametrize(("number", "status"), [(1, 129), (2, 130), (15, 143)])
def test_r13_signals(world, number, status, bridge_row):
    world.arms().at(6.0, lambda: world.kill.send(bytes([number])))
    world.at(6.1, lambda: world.kill.send(bytes([9])))  # a second one changes nothing
    assert world.run() == status
    assert world.guard.state is State.DISARMED
    braked = world.frames(BRAKE, 6.0)
    assert braked[0][0] == 6.0 and len(braked) > 20
    bridge_row("R13", f"signal {number}: seconds to the end", world.now - START - 6.0, 1.0, "s")


def test_r13_standard_input_is_closed(world, bridge_row):
    world.arms().at(6.0, lambda: (setattr(world, "hand", False), world.close_keys()))
    assert world.run() == 0
    assert world.loop.inputs == []
    assert world.frames(BRAKE, 6.0)[0][0] == 6.0
    bridge_row("R13", "closed standard input: seconds to the end", world.now - START - 6.0, 1.0, "s")


@pytest.mark.parametrize("words", ["quit\nclosed\nclosed\n", "closed\nquit\n"])
def test_the_word_closed_closes_nothing(world, words):
    world.at(1.0, words)
    assert world.run() == 0
    assert len(world.loop.inputs) == 1


def test_r14_the_policy_is_gone(world, bridge_row):
    world.arms().at(6.0013, lambda: (setattr(world, "policy_lives", False), world.policy.close()))
    assert world.run() == -1
    assert world.guard.fault.name == "POLICY_GONE" and world.guard.state is State.FAULT
    assert any(line.startswith("POLICY_GONE") for line in world.said)
    bridge_row(
        "R14", "seconds from the end of the policy to the brake", world.frames(BRAKE, 6.0)[0][0] - 6.0, 0.15, "s"
    )


def test_a_policy_that_ends_before_it_was_ready_is_no_fault(make_world):
    world = make_world()
    world._plan.clear()
    world.at(0.1, world.policy.close)
    assert world.run() == -1
    assert world.guard.fault is None and world.guard.state is State.DISARMED


def test_a_policy_whose_connection_breaks_is_gone(world, monkeypatch):
    class Broken:
        def fileno(self):
            return world.ours.fileno()

        def recv(self, size):
            raise ConnectionResetError

    world.arms().at(6.0, lambda: setattr(world.loop, "policy", Broken()))
    assert world.run() == -1
    assert world.guard.fault.name == "POLICY_GONE"


def test_what_ends_it_first_decides(world):
    world.arms().at(6.0, lambda: world.kill.send(b"\x02"))
    world.at(6.1, lambda: (setattr(world, "policy_lives", False), world.policy.close()))
    world.at(6.2, "quit\n")
    assert world.run() == 130
    assert world.guard.fault is None


def test_a_car_that_does_not_stop_is_left_behind_braked(world):
    world.arms().at(6.0, lambda: world.car.told.update(erpm=4000))
    world.at(6.0, "quit\n")
    assert world.run() == 0
    assert END_SECONDS == 0.9
    assert END_SECONDS <= world.now - START - 6.0 <= END_SECONDS + 0.041
    assert world.guard.state is State.STOPPING and world.wire[-1][2][0] == (BRAKE, 10_000)


def test_r24_the_space_bar_is_heard_between_two_cycles(world, bridge_row):
    world.arms().at(6.0043, " ")
    world.at(9.0, "quit\n")
    world.run()
    wait = world.frames(BRAKE, 6.001)[0][0] - 6.0043
    assert world.guard.fault.name == "E_STOP"
    assert not world.frames(RPM, 6.0043)
    bridge_row("R24", "seconds from the space bar to the brake", wait, 1e-9, "s")


def test_r24_a_file_stops_the_car(make_world, tmp_path, bridge_row):
    file = tmp_path / "estop"
    world = make_world(polled=[StopFile(str(file))])
    world.arms().at(6.001, file.touch)
    world.at(9.0, "quit\n")
    world.run()
    assert world.guard.fault.name == "E_STOP"
    bridge_row("R24", "seconds from the file to the brake", world.frames(BRAKE, 6.001)[0][0] - 6.001, 0.05, "s")


def test_r07_a_wild_command_brakes_at_once(world, bridge_row):
    world.arms().at(6.003, lambda: world.send(steering=math.nan))
    world.at(9.0, "quit\n")
    world.run()
    assert world.guard.fault.name == "BAD_COMMAND"
    bridge_row("R07", "seconds from NaN on the socket to the brake", world.frames(BRAKE, 6.0)[0][0] - 6.003, 1e-9, "s")


@pytest.mark.parametrize("size", [0, 43, 45, 3000])
def test_messages_of_other_sizes(world, size):
    world.arms().at(6.0, lambda: world.policy.send(bytes(size)))
    world.at(7.0, "quit\n")
    world.run()
    assert world.guard.fault.name == ("BAD_COMMAND" if size else "POLICY_GONE")
    assert not world.frames(RPM, 6.001)


def test_a_policy_that_floods_does_not_hold_up_the_loop(world):
    def flood():
        for _ in range(150):
            world.send()
        if world.now < START + 6.15:
            world.at(world.now - START + 0.001, flood)

    world.ours.setsockopt(1, 8, 1 << 20)
    world.arms().at(6.0, flood)
    world.policy.setsockopt(1, 7, 1 << 20)
    world.at(6.5, "quit\n")
    taken, received = [], []
    read, receive = world.loop._read_policy, world.loop._receive
    world.loop._receive = lambda: received.append(1) or receive()
    world.loop._read_policy = lambda now: (received.clear(), read(now), taken.append(len(received)))
    world.run()
    assert max(taken) == MOST_MESSAGES == 100
    assert max(len(record["in"]) for record in world.records()[1:]) == MOST_HAPPENINGS
    gaps = [later - earlier for (earlier, *_), (later, *_) in itertools.pairwise(world.wire) if earlier > 1]
    assert max(gaps) < 0.0201
    assert world.guard.fault is None


def test_a_message_that_was_sent_while_others_are_read_is_not_from_the_future(world):
    receive = world.loop._receive

    def slow():
        message = receive()
        if world.now > START + 6 and message:
            world.now += 0.0001
            if world._number % 2:
                world.send()  # another one, later than the moment at which the loop began to read
        return message

    world.loop._receive = slow
    world.arms().at(7.0, "quit\n")
    world.run()
    assert world.guard.fault is None


def test_a_policy_that_does_not_listen_is_no_matter(world):
    world.listens = False
    world.ours.setsockopt(1, 7, 1)  # the smallest buffer there is
    world.arms().at(8.0, "quit\n")
    assert world.run() == 0
    assert world.guard.fault is None
    world.listen()
    assert 0 < len(world.heard) < 300


def test_r16_the_loop_slept_and_finds_old_and_new_words(world, bridge_row):
    def sleep():
        for _ in range(50):
            world.now += 0.04
            world.send()
            world.type("g")

    world.arms().at(6.0, sleep)
    world.at(9.0, "quit\n")
    world.run()
    assert world.guard.fault.name == "GUARD_LATE"
    bridge_row("R16", "motion frames after a sleep of 2 s", len(world.frames(RPM, 6.001)), 0)


def test_r20_garbage_from_the_controller(world, bridge_row):
    def noise():
        world.answer(world.links[0], os.urandom(200) + b"\x02\x05\x08\x00\x00\x12\x06\x07\xfa\x03")
        world.at(world.now - START + 0.02, noise)

    world.arms().at(1.0, noise)
    world.at(7.0, "quit\n")
    assert world.run() == 0
    parser = world.loop._parser
    assert parser.dropped > 40_000 and parser.frames > 300
    assert world.car.metres > 1
    bridge_row("R20", "faults while noise comes between the answers", world.guard.fault is not None, 0)


def test_r29_the_log_makes_the_same_bytes_again(world, bridge_row):
    world.arms().at(5.5, lambda: setattr(world, "steering", 0.15))
    world.at(6.0, lambda: world.links[0].fails.update(write=_blocked()))
    world.at(6.1, lambda: world.links[0].fails.clear())
    world.at(7.5, lambda: world.answer(world.links[0], os.urandom(50)))
    world.at(8.0, "rubbish\n")
    world.at(9.0, "arm\n")
    world.at(10.0, "quit\n")
    world.run()
    records = world.records()
    guard, wrong, moved = Guard(Actuation(), GuardSettings()), 0, 0
    for record in records:
        for now, kind, value in record["in"]:
            guard.take(kind, value, now)
        frames = b"".join(guard.tick(record["t"]))
        wrong += frames != bytes.fromhex(record["out"]) or guard.state.value != record["state"]
        moved += record["speed"] > 0
    assert len(records) > 500 and moved > 50
    bridge_row("R29", f"{len(records)} cycles that come out otherwise when they are played again", wrong, 0)


def _blocked():
    from aerial2ground.guard.serial_link import LinkBlocked

    return LinkBlocked("for a test")


def test_r28_what_a_cycle_leaves_in_the_black_box(world, bridge_row):
    world.arms().at(6.0, lambda: setattr(world, "steering", 0.1))
    world.at(6.5, lambda: world.answer(world.links[0], b"\x02\x01"))
    world.at(7.0, " ")
    world.at(8.0, "quit\n")
    world.run()
    records = world.records()
    one = next(record for record in records if record["t"] > START + 6.5)
    assert one["state"] == "ARMED" and one["fault"] is None
    assert one["steering"] == 0.1 and one["speed"] == 1.0 and one["wanted"] == [0.1, 1.0]
    assert one["number"] == pytest.approx((one["t"] - START) * 50, abs=2)
    assert 0.03 <= one["picture_age"] <= 0.0501
    assert one["erpm"] == 4614 and one["volts"] == 11.8
    assert one["out"].startswith("0205080000120607fa03")
    assert {kind for _, kind, _ in one["in"]} == {"message", "payload", "word"}
    assert all(one["t"] - 0.0201 <= now <= one["t"] for now, _, _ in one["in"])
    first = records[0]
    assert first["in"] == [[START, "link", "up"], [START, "message", b"ready".hex()]] and first["t"] == START
    assert first["number"] is first["wanted"] is first["picture_age"] is first["erpm"] is first["volts"] is None
    last = records[-1]
    assert (last["state"], last["fault"]) == ("FAULT", "E_STOP")
    missing = len(world.wire) - sum(record["out"] != "" for record in records)
    bridge_row("R28", "cycles that the black box does not know", missing, 0)


def test_r27_without_a_port_nothing_is_opened(make_world, bridge_row):
    world = make_world(port="")
    world.steering = 0.1
    world.arms().at(7.5, "quit\n")
    assert world.run() == 0
    lines = [line for line in world.said if line.startswith("steering")]
    assert len(lines) == 7 and lines[-1] == "steering +0.100 rad, picture 43 ms old"
    assert any("it lacks a motor controller on the port" in line for line in world.said)
    bridge_row("R27", "ports that a dry run opens", len(world.attempts), 0)


def test_a_dry_run_without_commands_says_nothing(make_world):
    world = make_world(port="")
    world.policy_lives = False
    world.at(3.0, "quit\n")
    world.run()
    assert world.said == []


def test_r27_a_port_where_nobody_answers(world, bridge_row):
    world.car.answers = False
    with pytest.raises(UserError, match=r"^port: nothing there answers as a VESC does; give the motor"):
        world.run()
    seconds = world.now - START
    assert 0.7 < seconds < 0.73
    assert {frames for _, _, frames in world.wire} == {((FIRMWARE, 0),)}
    bridge_row("R27", "seconds until a port without motor controller is refused", seconds, 2.0, "s")


def test_r27_a_firmware_that_is_too_old(world, bridge_row):
    world.car.firmware = b"\x02\x12\x00"
    with pytest.raises(
        UserError, match=r"^port: the controller's firmware 2\.18 speaks another protocol; update it to 3"
    ):
        world.run()
    assert {frames for _, _, frames in world.wire} == {((FIRMWARE, 0),)}
    bridge_row("R27", "seconds until an old firmware is refused", world.now - START, 2.0, "s")


def test_a_controller_that_answers_late_is_in_time(world):
    world.car.answers = False
    world.at(0.5, lambda: setattr(world.car, "answers", True))
    world.at(2.0, "quit\n")
    assert world.run() == 0
    assert world.guard.firmware == (6, 2, "bench")


def test_the_announcer_prints_from_its_thread():
    stream = io.StringIO()
    announcer = Announcer(stream)
    announcer.say("one")
    announcer.say("two")
    announcer.close()
    assert stream.getvalue() == "one\ntwo\n"
    assert not announcer._thread.is_alive() and announcer._thread.daemon


def test_an_announcer_whose_terminal_is_gone_goes_on():
    class Gone(io.StringIO):
        lines = 0

        def write(self, text):
            self.lines += 1
            raise OSError if self.lines % 2 else ValueError

    stream = Gone()
    announcer = Announcer(stream)
    for _ in range(4):
        announcer.say("hello")
    announcer.close()
    assert stream.lines == 4 and not announcer._thread.is_alive()


def test_an_announcer_whose_terminal_hangs_holds_up_nobody():
    goes_on = threading.Event()

    class Hangs(io.StringIO):
        def flush(self):
            goes_on.wait(30)

    announcer = Announcer(Hangs())
    for _ in range(100):
        announcer.say("hello")
    announcer.close()
    assert announcer._thread.is_alive()
    goes_on.set()
    announcer._thread.join(30)
    assert not announcer._thread.is_alive()
